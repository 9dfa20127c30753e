"""What the viewer needs to know of a call: its members, and how each face looks right now.

This is the whole interface between the network half of the receiver and its drawing half. The
receiver of a call implements `FaceSource`; so does anything else that has faces to show (a player
of recordings, a test).

    faces = source.faces(now)            # once per drawn frame, on the drawing thread
    avatar = source.avatar(face.avatar_id)
    source.subscribe(face.peer_id, every, now)
"""

from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from pica_core.avatar.file import Avatar
from pica_core.types import FloatArray

FaceStatus = Literal["waiting", "live", "concealed", "stale", "away"]
"""How fresh a face is.

waiting: nothing received yet; live: a received or interpolated sample; concealed: held or
extrapolated over a hole;
stale: nothing for so long that it should be shown as such; away: the sender's tracker sees no face.
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FaceState:
    """One peer's face at display time."""

    peer_id: str
    """Unique in the call and stable while the connection stays."""
    name: str
    """Display name; drawn as it is, so the receiver has limited its length already."""
    avatar_id: str
    """SHA-256 of the avatar file, hexadecimal."""
    latent: FloatArray | None
    """Expression code at display time, float32 ``[8, 8, 4]``; None while nothing has arrived."""
    rotation: FloatArray = field(default_factory=lambda: np.zeros(3, np.float32))
    """Head to seat, rotation vector in radians. float32 ``[3]``."""
    translation_m: FloatArray = field(default_factory=lambda: np.zeros(3, np.float32))
    """Head offset from its seat, metres, seat axes. float32 ``[3]``."""
    captured_us: int = 0
    """Sender's clock at the *newest* sample that went into `latent`, for measuring latency. Between
    two samples the latent may move on while this stands still."""
    status: FaceStatus = "live"
    note: str = ""
    """What is wrong with the stream, for people; empty when nothing is."""
    place: int = 0
    """Number of the person, unique in the call and kept when the person comes back as another
    peer. Rises with the order of coming."""


class FaceSource(Protocol):
    """Where a viewer gets its faces. Called on the drawing thread only; must not block."""

    def faces(self, now: float, ahead_s: float = 0.0) -> list[FaceState]:
        """Everybody who should have a seat at local time `now`, seconds; by rising place.

        ``ahead_s`` is in how many seconds these faces will be seen: lips go with the sound that is
        heard then.
        """
        ...

    def avatar(self, avatar_id: str) -> Avatar | None:
        """The avatar with this id; None while it is still on its way.

        Raises:
            AvatarFileError: It came, and must not be used. The viewer shows a placeholder with the
                message.
        """
        ...

    def subscribe(self, peer_id: str, every: int, now: float) -> None:
        """Say how much of a peer's stream is worth having, as often as every drawn frame.

        Args:
            peer_id: Whose; a peer that has left is no error.
            every: 1 for every frame, 2 or 4 for each second or fourth one, 0 for nothing at all.
            now: Local time, seconds.
        """
        ...
