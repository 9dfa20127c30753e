"""Captures on disk in the Multiface layout: read, written and checked."""
