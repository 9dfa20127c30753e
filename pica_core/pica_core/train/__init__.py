"""Training: rasteriser, losses, loop, evaluation, export. Needs the extra ``train``."""
