"""What the members of a room tell each other of their tracks: kinds, and metadata."""

from typing import Final, Literal

from pica_protocol.messages import Peer, Track

FACE_TRACK: Final = "face"
"""Kind of the tracks whose payloads are latents."""
FACE_KEY: Final = "face"
"""The metadata key under which a peer says why it sends no face: "muted" or `FACE_LOST`."""
FACE_LOST: Final = "lost"
"""The tracker sees no face."""
FaceMode = Literal["sent", "muted"]

RECORDS_KEY: Final = "records"
"""The metadata key under which a peer says `RECORDS_YES` while it keeps what it sees."""
RECORDS_YES: Final = "yes"

VOICE_TRACK: Final = "voice"
"""Kind of the tracks whose payloads are voice packets."""
VOICE_KEY: Final = "voice"
"""The metadata key under which a peer says why it is not heard: `VOICE_MUTED`."""
VOICE_MUTED: Final = "muted"


def voice_of(peer: Peer) -> Track | None:
    """Return the first voice of a peer, or None."""
    return next((each for each in peer.tracks if each.kind == VOICE_TRACK), None)
