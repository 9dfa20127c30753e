"""What a peer says of its face to the others: the kind of its track, and why it stands still."""

from typing import Final, Literal

FACE_TRACK: Final = "face"
"""Kind of the tracks whose payloads are latents."""
FACE_KEY: Final = "face"
"""The metadata key under which a peer says why its face stands still: "muted" or "frozen"."""

FaceMode = Literal["sent", "frozen", "muted"]
