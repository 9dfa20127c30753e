"""Sockets of a relay: the websocket, the pump behind it, limits and proxies in front of it."""
