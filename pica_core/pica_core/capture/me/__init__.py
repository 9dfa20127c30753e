"""Avatars of real people: the face model is fitted to a scan."""
