"""Captures: built-in heads, the stage, the dataset layout and its reader. Needs no torch."""
