"""Held-out error of finished runs by the paper's protocol."""
