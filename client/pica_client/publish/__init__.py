"""The sending half of a call: expressions in, coded frames out at a steady rate."""
