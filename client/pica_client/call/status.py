"""How the call stands, and who is in it, to be shown. Pure.

People are listed oneself first, then the others in order of coming. Watchers are in it, too: all
who can see us are listed.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from pica_client.call.connection_quality import Quality
from pica_client.call.roster import Member, News, NewsKind
from pica_core.types import FloatArray

NAMES_IN_A_ROW: Final = 3
"""Names in one line; of more, the others are counted."""


FaceStatus = Literal["waiting", "live", "concealed", "stale", "away"]
"""How fresh a face is.

waiting: nothing received yet; live: a received or interpolated sample; concealed: held over a
hole; stale: nothing for so long that it should be shown as such; away: the sender's tracker sees
no face.
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


@dataclass(frozen=True, kw_only=True, slots=True)
class CallStatus:
    """How the call stands."""

    is_connected: bool = True
    """Whether the relay has us in the room."""
    away_s: float = 0.0
    """How long it has not."""
    own_quality: Quality = "unknown"
    is_admin: bool = False
    """Whether our token lets us moderate the room."""
    muted_by_admin: str = ""
    """What an admin has stopped of our own: "face", "voice", both, or nothing."""
    own_trouble: str = ""
    """What is wrong with the tracker of our own face; empty: nothing, or there is none."""
    participants: tuple[Member, ...] = ()
    """Oneself, and everybody else in the order of coming."""
    news: tuple[News, ...] = ()
    """What happened since the last status."""
    room: str = ""
    """Where we are; empty outside a call."""
    invitation: str = ""
    """A line that leads others here."""
    is_encrypted: bool = False
    """Whether faces are encrypted end to end."""
    code: str = ""
    """Digits that everybody who sees the same people has, too; empty without encryption, and while
    no other member is verified."""
    duration_s: float = 0.0
    """Since we came in for the first time."""


NoticeTone = Literal["plain", "good", "warning", "alert"]

_SAID: dict[NewsKind, tuple[str, NoticeTone]] = {
    "joined": ("joined", "plain"),
    "left": ("left", "plain"),
    "away": ("lost the connection", "warning"),
    "back": ("came back", "good"),
    "records": ("records the call", "alert"),
    "records no more": ("stopped recording", "plain"),
}
_SAID_OF_MANY = {"records": "record the call"}


def notices(news: Sequence[News]) -> list[tuple[str, NoticeTone]]:
    """What happened, in words, with how loud to say it; what happened to several at once is one
    line."""
    said = []
    for kind, (one, tone) in _SAID.items():
        names = [each.name for each in news if each.kind == kind]
        if names:
            what = one if len(names) == 1 else _SAID_OF_MANY.get(kind, one)
            said.append((f"{joined_names(names)} {what}", tone))
    return said


def joined_names(names: Sequence[str]) -> str:
    """Names as one reads them out: "Ada, Ben and 3 others"."""
    shown = list(names) if len(names) <= NAMES_IN_A_ROW else list(names[: NAMES_IN_A_ROW - 1])
    if len(shown) < len(names):
        shown.append(f"{len(names) - len(shown)} others")
    return " and ".join(filter(None, (", ".join(shown[:-1]), shown[-1])))


def recorders(participants: Iterable[Member]) -> list[str]:
    """The names of those who keep what they see; oneself is "You"."""
    return ["You" if each.is_self else each.name for each in participants if each.is_recording]


def duration_text(duration_s: float) -> str:
    """How long a call has lasted: 4:07, or 1:02:03."""
    minutes, seconds = divmod(max(int(duration_s), 0), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
