"""Sender and receiver: sources, playout, decoding, drawing, and the shells around them."""
