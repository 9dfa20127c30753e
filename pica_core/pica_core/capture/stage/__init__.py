"""The dome: cameras, takes, depth and tracker around the head in the middle."""
