"""Avatars of real people: the face model is fitted to a scan, to photos or to a video."""
