"""Levels of detail, given to a trained avatar: early exits and coarser meshes."""
