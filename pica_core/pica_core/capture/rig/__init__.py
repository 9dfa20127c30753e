"""Blendshape rigs from files, made ready to stand on the stage."""
