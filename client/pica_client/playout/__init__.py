"""From frames as the network delivers them to a face at display time. Pure."""
