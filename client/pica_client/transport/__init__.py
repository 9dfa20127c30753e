"""The way to a relay: one websocket, its session, and what happens when it breaks."""
