"""What a voice is to the room: the kind of its track, and what its owner says of it."""

from typing import Final

from pica_protocol.messages import Peer, Track

VOICE_TRACK: Final = "voice"
"""Kind of the tracks whose payloads are voice packets."""
VOICE_KEY: Final = "voice"
"""The metadata key under which a peer says why it is not heard: `VOICE_MUTED`."""
VOICE_MUTED: Final = "muted"
DEADLINE_MS: Final = 200
"""How long a packet may wait on its way (chosen: as long as the longest delay that is waited for
before it is heard)."""


def voice_track() -> Track:
    """Return the track that a voice of ours travels on."""
    return Track(kind=VOICE_TRACK, policy="ordered", deadline_ms=DEADLINE_MS)


def voice_of(peer: Peer) -> Track | None:
    """Return the first voice of a peer; None: it has none."""
    return next((track for track in peer.tracks if track.kind == VOICE_TRACK), None)


def refusal_of(track: Track) -> str:
    """Say in words why a voice cannot be heard here; empty: it can.

    An empty ``profile`` is Opus in packets of 20 ms; another codec would name itself there.
    """
    if track.profile:
        return f"their voice is of a codec that is not known here ({track.profile[:8]})"
    if track.policy != "ordered":
        return f"their voice says that old packets are replaced by new ones ({track.policy})"
    return ""
