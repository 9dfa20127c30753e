"""The members of a room, in the order in which they came, and what of their coming is news. Pure.

All who can see the others are members, whether they publish a face or only watch.

A place belongs to a person, and not to a peer id: when the relay starts again, ids are new and
people come back in any order. A newcomer with the name, and at best the avatar too, of a member who
was there a moment ago gets the place of that member, so places are not swapped.

Names are compared as they look. Two are alike if they differ in nothing but case, spaces,
characters that leave no ink, and letters that are drawn the same way: a Cyrillic A, a one for an l.
What looks like what is Unicode's list (UTS 39, confusables.txt), as `confusable_homoglyphs` brings
it. Letters that merely resemble each other, as with and without an accent, are not alike.

    receive_event(event, now)    what came of the link
    handle_timer(now)            at any time, as twice a second
    take_news()                  what happened since the last call
"""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Final, Literal

from pica_client.call.connection_quality import Quality
from pica_client.tracks import (
    FACE_KEY,
    FACE_TRACK,
    RECORDS_KEY,
    RECORDS_YES,
    VOICE_KEY,
    VOICE_MUTED,
    FaceMode,
    voice_of,
)
from pica_protocol import messages
from pica_protocol.limits import draws_nothing
from pica_protocol.session import ClientEvent

AWAY_IS_NEWS_AFTER_S: Final = 2.0
"""Notices of shorter outages are suppressed."""
LEFT_IS_NEWS_AFTER_S: Final = 15.0
"""How long a member from before a restart of the relay is waited for (chosen: twice the
longest pause between two tries of a client)."""
PLACE_IS_KEPT_S: Final = 120.0
"""How long the place of a member who has gone is kept (chosen: a laptop changes networks)."""
MAX_KEPT: Final = 64
"""Places that are kept; the oldest are given up first."""
MAX_NEWS: Final = 64
"""News not yet taken: beyond these the oldest are dropped."""

SELF_ID: Final = "self"
"""Stands for oneself among the peers; what counts is the place."""
SECRET_NEEDED: Final = "encrypted: the room's secret is needed"
"""Note on a member who encrypts when we do not."""

NewsKind = Literal["joined", "left", "away", "back", "records", "records no more"]


@dataclass(frozen=True, slots=True)
class News:
    """Something that happened to another member."""

    kind: NewsKind
    name: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Member:
    """A member of the room."""

    peer: messages.Peer
    place: int = -1
    """Rises with the order of coming; constant while the member is here; -1 for oneself."""
    namesake: int = 1
    """Counts those of one name, from 1; kept when others of that name go."""
    is_away: bool = False
    """Whether the connection is lost and may come back."""
    muted_streams: frozenset[int] = frozenset()
    """What an admin has stopped of theirs."""
    has_whispered: bool = False
    """Whether it has sent us a key that we can do nothing with: it encrypts, and we do not."""

    quality: Quality = "unknown"
    is_verified: bool = False
    """Whether it has proven to know the room's secret, where faces are encrypted."""
    warning: str = ""
    """Why the name may mislead; empty: no reason to think so."""
    note: str = ""
    """Why the face is not to be seen, or not as it should be; empty: nothing is wrong."""

    @property
    def peer_id(self) -> str:
        """The id of the peer; `SELF_ID` for oneself."""
        return self.peer.peer_id

    @property
    def name(self) -> str:
        """The name, with a number if another member had it first."""
        return self.peer.name if self.namesake == 1 else f"{self.peer.name} ({self.namesake})"

    @property
    def is_self(self) -> bool:
        """Whether this is oneself."""
        return self.place < 0

    @property
    def line(self) -> str:
        """What stands under the name; empty when there is nothing to say."""
        if self.note:
            return self.note
        if self.is_watching:
            return "watching"
        return "poor connection" if self.quality == "poor" else ""

    @property
    def muted_kinds(self) -> frozenset[str]:
        """What an admin has stopped of theirs: "face", "voice"."""
        tracks = self.peer.tracks
        return frozenset(each.kind for each in tracks if each.stream in self.muted_streams)

    @property
    def is_watching(self) -> bool:
        """Whether there is no face to be expected."""
        return all(track.kind != FACE_TRACK for track in self.peer.tracks)

    @property
    def face(self) -> FaceMode:
        """What becomes of the face, as far as its owner says."""
        return "muted" if dict(self.peer.metadata).get(FACE_KEY) == "muted" else "sent"

    @property
    def is_voice_muted(self) -> bool:
        """Whether the voice is muted, as its owner says."""
        return dict(self.peer.metadata).get(VOICE_KEY) == VOICE_MUTED

    @property
    def has_voice(self) -> bool:
        """Whether a voice is sent."""
        return voice_of(self.peer) is not None

    @property
    def is_recording(self) -> bool:
        """Whether this one says to keep what is seen."""
        return dict(self.peer.metadata).get(RECORDS_KEY) == RECORDS_YES


@dataclass(slots=True)
class _Missing:
    """A member who was there, and has not come back yet."""

    member: Member
    gone_s: float
    is_told: bool
    """Whether it is known that this one has left; else the relay started again."""


@dataclass(slots=True)
class Roster:
    """Keeps the list.

    Attributes:
        own_name: What we are called; empty: unknown.
        joined_s: When we came in for the first time; None before.
    """

    own_name: str = ""
    joined_s: float | None = None
    _members: dict[str, Member] = field(default_factory=dict)
    _missing: list[_Missing] = field(default_factory=list)
    _away_s: dict[str, float] = field(default_factory=dict)
    """Since when, of those whose being away is no news yet."""
    _news: list[News] = field(default_factory=list)
    _next_place: int = 0

    @property
    def members(self) -> list[Member]:
        """Everybody else, in the order of coming."""
        return sorted(self._members.values(), key=lambda member: member.place)

    def member(self, peer_id: str) -> Member:
        """Return the member with this id; it must be here."""
        return self._members[peer_id]

    def receive_event(self, event: ClientEvent, now: float) -> None:
        """Take an event of the link's session at `now`, seconds."""
        match event:
            case messages.Joined():
                self._receive_joined(event, now)
            case messages.PeerJoined(peer=peer):
                self._add(peer, is_news=True)
            case messages.PeerLeft(peer_id=peer_id) if peer_id in self._members:
                self._away_s.pop(peer_id, None)
                self._keep([self._members.pop(peer_id)], now, is_told=True)
            case messages.PeerAway(peer_id=peer_id, is_away=is_away) if peer_id in self._members:
                member = self._members[peer_id] = replace(self._members[peer_id], is_away=is_away)
                if is_away:
                    self._away_s[peer_id] = now
                elif self._away_s.pop(peer_id, None) is None:
                    self._tell("back", member)
            case messages.PeerUpdated(peer_id=peer_id, metadata=metadata) if (
                peer_id in self._members
            ):
                member = self._members[peer_id]
                self._update(member, replace(member.peer, metadata=metadata))
            case messages.StreamMuted(stream=stream, is_muted=is_muted):
                for peer_id, member in self._members.items():
                    if any(track.stream == stream for track in member.peer.tracks):
                        muted = member.muted_streams - {stream}
                        muted |= {stream} if is_muted else set()
                        self._members[peer_id] = replace(member, muted_streams=muted)
            case messages.Whisper(peer_id=peer_id) if peer_id in self._members:
                self._members[peer_id] = replace(self._members[peer_id], has_whispered=True)
            case _:
                pass

    def handle_timer(self, now: float) -> None:
        """Note what has lasted long enough to be news."""
        for peer_id, away_s in list(self._away_s.items()):
            if now - away_s >= AWAY_IS_NEWS_AFTER_S:
                del self._away_s[peer_id]
                self._tell("away", self._members[peer_id])
        for missing in self._missing:
            if not missing.is_told and now - missing.gone_s >= LEFT_IS_NEWS_AFTER_S:
                missing.is_told = True
                self._tell("left", missing.member)
        self._missing = [each for each in self._missing if now - each.gone_s < PLACE_IS_KEPT_S]

    def take_news(self) -> list[News]:
        """What happened since the last call, in order."""
        news, self._news = self._news, []
        return news

    def _receive_joined(self, event: messages.Joined, now: float) -> None:
        is_first = self.joined_s is None
        self.own_name = event.name or self.own_name
        self.joined_s = now if is_first else self.joined_s
        before, self._members = self._members, {}
        self._away_s.clear()
        if event.resumed:  # ids mean whom they meant
            for peer in event.peers:
                if peer.peer_id in before:
                    self._update(_reset(before.pop(peer.peer_id)), peer)
        self._keep(before.values(), now, is_told=event.resumed)
        for peer in event.peers:
            if peer.peer_id not in self._members:
                self._add(peer, is_news=not is_first)

    def _update(self, before: Member, peer: messages.Peer) -> None:
        """Take what a member says of itself by now."""
        after = self._members[peer.peer_id] = replace(before, peer=peer)
        if after.is_recording != before.is_recording:
            self._tell("records" if after.is_recording else "records no more", after)

    def _add(self, peer: messages.Peer, *, is_news: bool) -> None:
        if peer.peer_id in self._members:
            return
        found = self._find_missing(peer)
        if found is not None:
            self._missing.remove(found)
            if not found.is_told and _tracks(found.member.peer) == _tracks(peer):
                self._update(_reset(found.member), peer)
                return
        taken = {each.namesake for each in self._members.values() if each.peer.name == peer.name}
        if peer.name == self.own_name:
            taken.add(1)
        namesake = min(set(range(1, len(taken) + 2)) - taken)
        place = self._next_place if found is None else found.member.place
        member = Member(peer=peer, place=place, namesake=namesake)
        self._next_place += found is None
        self._members[peer.peer_id] = member
        if is_news:
            self._tell("joined", member)
        if member.is_recording:
            self._tell("records", member)

    def _keep(self, gone: Iterable[Member], now: float, *, is_told: bool) -> None:
        for member in gone:
            self._missing.append(_Missing(member, now, is_told))
            if is_told:
                self._tell("left", member)
        del self._missing[:-MAX_KEPT]

    def _find_missing(self, peer: messages.Peer) -> _Missing | None:
        """Return whose place a newcomer takes: at best, of a member with the same tracks."""
        found = [each for each in self._missing if each.member.peer.name == peer.name]
        alike = (each for each in found if _tracks(each.member.peer) == _tracks(peer))
        return next(alike, found[0] if found else None)

    def _tell(self, kind: NewsKind, member: Member) -> None:
        self._news = [*self._news, News(kind, member.name)][-MAX_NEWS:]


def _reset(member: Member) -> Member:
    """A member of a new connection: what is so still is told again."""
    return replace(member, is_away=False, muted_streams=frozenset())


def _tracks(peer: messages.Peer) -> tuple[tuple[str, str], ...]:
    """What of a peer's tracks stays the same when a relay deals new ids and streams."""
    return tuple((track.kind, track.avatar) for track in peer.tracks)


# Names that look alike

_SELF = ""
"""Stands for ourselves among the peer ids."""
_BARE_MARKS = re.compile("[\u034f\u17b4\u17b5\u180b-\u180f\ufe00-\ufe0f\U000e0100-\U000e01ef]")
"""Marks that leave no ink on their letter either: joiners and variation selectors."""
_ADDED = re.compile(r"[(\[{<][^)\]}>]*[)\]}>]?|\s+[-–—~•·*|/].*|[,:;].*")
"""What people add to a name, such as a role."""
_OF_LETTER = re.compile(
    "(?:LATIN LETTER SMALL CAPITAL|NEGATIVE .* LATIN CAPITAL LETTER|REGIONAL .* LETTER) ([A-Z])"
)
"""Unicode's names of letters in another dress, which its list does not have."""
_DIGITS = {"8": "B", "5": "S", "2": "Z"}
"""Digits that look like letters, which its list does not have either."""


def name_warnings(peers: Iterable[messages.Peer], own_name: str = "") -> dict[str, str]:
    """Look for names that are the same, or look the same, and warn of possible impersonation.

    Of those whose names are alike, one whose name alone is assured gets no warning.

    Args:
        peers: Everybody else in the room.
        own_name: Ours, as the others see it: names like ours are warned of too. Empty: unknown.

    Returns:
        By peer id a warning for people, in a few words; empty: the name is unique.
    """
    people = {peer.peer_id: peer for peer in peers}
    names = {_SELF: own_name} | {peer_id: peer.name for peer_id, peer in people.items()}
    bearers: dict[str, set[str]] = defaultdict(set)
    for peer_id, name in names.items():
        for look in _looks(name):
            bearers[look].add(peer_id)
    warnings = {}
    for peer_id, peer in people.items():
        alike = set[str]().union(*(bearers[look] for look in _looks(peer.name))) - {peer_id}
        assured = {other for other in alike - {_SELF} if people[other].is_name_assured}
        note = ""
        if _SELF in alike:
            note = "has your name" if peer.name == own_name else "looks like your name"
        elif alike and (assured or not peer.is_name_assured):
            other = names[min(assured or alike)]
            whose = f"the assured {other}" if assured else other
            note = f"not {whose}" if assured and not peer.is_name_assured else f"also {other}"
            if other != peer.name:
                note = f"looks like {whose}"
        warnings[peer_id] = note
    return warnings


@cache
def _look(character: str) -> str:
    """Return what stands for all characters that look like one."""
    # Read with the first name: 50 ms of a processor and 17 MB (measured).
    from confusable_homoglyphs.confusables import confusables_data

    def alike(text: str) -> list[str]:
        return [entry["c"] for entry in confusables_data.get(text, ())]

    named = _OF_LETTER.fullmatch(unicodedata.name(character, ""))
    character = named[1] if named else _DIGITS.get(character, character)
    # The list pairs each character with the one that stands for its kind, and that with all.
    return max([character, *alike(character)], key=lambda text: (len(alike(text)), text))


def _looks(name: str) -> set[str]:
    """Return what a name looks like: two names that share one of these are alike."""
    marked = _BARE_MARKS.sub("", unicodedata.normalize("NFKC", name))
    plain = _letters(_ADDED.sub("", marked)) or _letters(marked) or marked
    # A capital i looks like an l, and a small one is the same name: both are to be found.
    looks = ("".join(map(_look, plain)).casefold(), "".join(map(_look, plain.casefold())))
    return set(filter(None, looks))


def _letters(text: str) -> str:
    """Return the letters and digits of a text, what looks like them, and their marks; empty if it
    has no letter."""

    def counts(character: str) -> bool:
        return _look(character)[0].isalnum() and not draws_nothing(character)

    if not any(map(counts, text)):
        return ""
    return "".join(c for c in text if counts(c) or unicodedata.category(c)[0] == "M")
