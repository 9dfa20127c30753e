"""Rooms that live on several relays, over NATS."""
