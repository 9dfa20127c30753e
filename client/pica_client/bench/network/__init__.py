"""Troubled networks for benches: a model on a virtual clock, and a proxy on loopback."""
