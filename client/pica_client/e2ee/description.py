"""What a peer says of itself in its notes, so that the relay cannot say otherwise.

    description = SHA-256 of these texts, each with its length before it (2 bytes, then UTF-8):
        "pica seal 2 peer", room, name, and for each track
        kind, policy, avatar, profile, stream, deadline_ms      (numbers in decimal)

The room is the one that was asked for. What may change in a call (metadata) is not in it.
"""

import hashlib
from collections.abc import Iterable
from typing import Final

from pica_protocol.messages import Track

DESCRIPTION_BYTES: Final = 32


def describe(room: str, name: str, tracks: Iterable[Track]) -> bytes:
    """Return the description of a peer with this name and these tracks in this room."""
    texts = ["pica seal 2 peer", room, name]
    for track in tracks:
        texts += [track.kind, track.policy, track.avatar, track.profile]
        texts += [str(track.stream), str(track.deadline_ms)]
    encoded = [text.encode() for text in texts]
    return hashlib.sha256(b"".join(len(text).to_bytes(2) + text for text in encoded)).digest()
