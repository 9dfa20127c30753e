"""The dome: cameras, takes, depth and tracker around whoever stands in the middle."""
