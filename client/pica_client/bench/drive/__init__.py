"""Avatars driven by a face as it moves, against the head itself: a bench and its steps."""
