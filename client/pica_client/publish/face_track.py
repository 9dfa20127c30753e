"""What a peer says of itself to the others: the kind of its track, why its face stands still, and
whether it records."""

from typing import Final, Literal

FACE_TRACK: Final = "face"
"""Kind of the tracks whose payloads are latents."""
FACE_KEY: Final = "face"
"""The metadata key under which a peer says why its face stands still: "muted", "frozen" or
`FACE_LOST`."""
FACE_LOST: Final = "lost"
"""The tracker sees nobody."""

RECORDS_KEY: Final = "records"
"""The metadata key under which a peer says `RECORDS_YES` while it keeps what it sees."""
RECORDS_YES: Final = "yes"

FaceMode = Literal["sent", "frozen", "muted"]
