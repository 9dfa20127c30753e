"""Trackers that send a face while it moves: their protocols, and the way from samples to a face."""
