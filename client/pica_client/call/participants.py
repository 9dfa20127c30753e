"""The people of a call as a list to be shown: oneself first, then the others in order of coming.

Pure. Watchers are in it, too: all who can see us are listed.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from pica_client.call.connection_quality import Quality
from pica_client.call.names import name_warnings
from pica_client.call.roster import News, NewsKind, RoomState
from pica_client.tracks import FaceMode

NAMES_IN_A_ROW: Final = 3
"""Names in one line; of more, the others are counted."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Participant:
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


def list_participants(
    own: Participant,
    room: RoomState,
    quality: Mapping[str, Quality],
) -> tuple[Participant, ...]:
    """Everybody in the room.

    Args:
        quality: By peer id; unknown of who is missing there.
    """
    warnings = name_warnings((member.peer for member in room.members), own.name)
    listed = [own]
    for member in room.members:
        peer_id = member.peer.peer_id
        listed.append(
            Participant(
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


def recorders(participants: Iterable[Participant]) -> list[str]:
    """The names of those who keep what they see; oneself is "You"."""
    return ["You" if each.is_self else each.name for each in participants if each.is_recording]


def duration_text(duration_s: float) -> str:
    """How long a call has lasted: 4:07, or 1:02:03."""
    minutes, seconds = divmod(max(int(duration_s), 0), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
