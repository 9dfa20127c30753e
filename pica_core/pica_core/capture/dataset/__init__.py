"""Captures on disk in the Multiface layout: read, written, checked, shown on a sheet."""
