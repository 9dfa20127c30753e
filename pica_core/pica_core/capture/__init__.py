"""Captures: people and rigs, the stage, the dataset layout and its reader. Needs no torch."""
