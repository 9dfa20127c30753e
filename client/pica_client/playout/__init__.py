"""The playout buffer: frames as the network delivers them, faces at display time. Pure."""
