"""The commands of training; they need the extra ``train``."""
