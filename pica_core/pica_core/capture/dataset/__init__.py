"""Captures on disk in the Multiface layout: read and written."""
