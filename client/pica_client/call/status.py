"""How the call stands, who is in it, and what its avatars cost, to be shown. Pure.

People are listed oneself first, then the others in order of coming. Watchers are in it, too: all
who can see us are listed.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from pica_client.call.connection_quality import Quality, StreamHealth
from pica_client.call.names import name_warnings
from pica_client.call.roster import News, NewsKind, RoomState
from pica_client.tracks import FaceMode

NAMES_IN_A_ROW: Final = 3
"""Names in one line; of more, the others are counted."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Person:
    """One line of the list."""

    peer_id: str
    """Empty for oneself."""
    place: int = -1
    """See `Member.place`; -1 for oneself."""
    name: str
    """What the others are shown, with a number if another member had it first."""
    is_self: bool = False
    is_watching: bool = False
    """Whether there is no face to be expected."""
    is_away: bool = False
    is_recording: bool = False
    face: FaceMode = "sent"
    has_voice: bool = False
    is_voice_muted: bool = False
    """Whether its owner has muted it."""
    quality: Quality = "unknown"
    is_verified: bool = False
    """Whether it has proven to know the room's secret, where faces are encrypted."""
    identity: str = ""
    """The one of their token; empty without tokens."""
    muted_kinds: frozenset[str] = frozenset()
    """What an admin has stopped of theirs: "face", "voice"."""
    is_assured: bool = False
    """Whether the relay has the name from a token."""
    warning: str = ""
    """Why the name may mislead; empty: no reason to think so."""
    note: str = ""
    """Why the face is not to be seen, or not as it should be; empty: nothing is wrong."""

    @property
    def line(self) -> str:
        """What stands under the name; empty when there is nothing to say."""
        if self.note:
            return self.note
        if self.is_watching:
            return "watching"
        return "poor connection" if self.quality == "poor" else ""


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerStatus:
    """How one participant's stream comes in."""

    quality: Quality = "unknown"
    payload_bps: float | None = None
    """Bits a second over the last seconds; None before there were any."""
    health: StreamHealth = field(default_factory=StreamHealth)


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
    peers: Mapping[str, PeerStatus] = field(default_factory=dict)
    """How each stream comes in, by peer id."""
    participants: tuple[Person, ...] = ()
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
    summary: tuple[tuple[str, str], ...] = ()
    """Further figures for the statistics, name and value."""


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarFigures:
    """What one avatar costs, over its latest frames."""

    level: int | None
    """Rows of the position map shown; None before the first."""
    decode_ms: float | None
    latency_ms: float | None
    """Time from the sender's sample to its decoded maps; meaningful on one machine only."""
    num_decoded: int
    is_speaking: bool


def list_participants(
    own: Person,
    room: RoomState,
    quality: Mapping[str, Quality],
) -> tuple[Person, ...]:
    """Everybody in the room.

    Args:
        quality: By peer id; unknown of who is missing there.
    """
    warnings = name_warnings((member.peer for member in room.members), own.name)
    listed = [own]
    for member in room.members:
        peer_id = member.peer.peer_id
        listed.append(
            Person(
                peer_id=peer_id,
                place=member.place,
                name=member.title,
                is_watching=member.is_watching,
                is_away=member.is_away,
                is_recording=member.is_recording,
                face=member.face,
                has_voice=member.has_voice,
                is_voice_muted=member.is_voice_muted,
                quality=quality.get(peer_id, "unknown"),
                is_verified=peer_id in room.verified,
                identity=member.peer.identity,
                muted_kinds=frozenset(
                    track.kind
                    for track in member.peer.tracks
                    if track.stream in member.muted_streams
                ),
                is_assured=member.peer.is_name_assured,
                warning=warnings[peer_id],
                note="connection lost" if member.is_away else room.notes.get(peer_id, ""),
            )
        )
    return tuple(listed)


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


def recorders(participants: Iterable[Person]) -> list[str]:
    """The names of those who keep what they see; oneself is "You"."""
    return ["You" if each.is_self else each.name for each in participants if each.is_recording]


def duration_text(duration_s: float) -> str:
    """How long a call has lasted: 4:07, or 1:02:03."""
    minutes, seconds = divmod(max(int(duration_s), 0), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
