"""Heads on their seats, drawn with moderngl: visible triangles first, then the pixel decoder."""
