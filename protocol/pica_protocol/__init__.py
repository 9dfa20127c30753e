"""The language of the wire: bytes <-> messages, and the handshake. No socket, no clock."""

SUBPROTOCOL = "pica.2"
"""The websocket sub-protocol both sides name; the digit changes when old peers could not follow."""
