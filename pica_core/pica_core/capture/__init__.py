"""Captures: the synthetic stage and its heads, the dataset layout, and its reader. numpy, moderngl and pillow only."""
