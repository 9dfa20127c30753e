"""The control messages: frozen records that check their own limits.

Those of a room are of the sub-protocol ``pica.2``. ``Offer``, ``Ready`` and ``Stored`` are of
``pica.store.1``, which gives a relay a file for its avatar store: a websocket of its own on the
relay's port, one file each. The client sends ``Offer``; the relay answers ``Stored`` when it has
the file, else ``Ready``, and then takes chunks, in order, until it has as many bytes as were
offered. It checks them and answers ``Stored``. Whatever goes wrong on either side ends with ``Bye``
and a close frame. Getting a file back is plain HTTP: ``GET /avatars/ID``.

Direction and bytes of each are shown in ``docs/wire.md``. The annotations are the schema that
``codec.py`` reads: ``int``, ``bool``, ``str``, ``bytes``, another record, a tuple
of one of these, or ``Metadata``; what an annotation adds to a type is the field's limit.
"""

import functools
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, cast, get_args, get_type_hints

from pica_protocol import limits

MAX_TRACK_KIND_BYTES: Final = 16
SHARES: Final = (0, 1, 2, 4)
"""What may be asked for of a stream: none of it, all, or each second or fourth sequence number."""
Metadata = tuple[tuple[str, str], ...]
"""What a peer says of itself, a few short texts by key; a map on the wire."""
BYE_CODES: Final = (1000, 1001, 1009, 1011)
"""Codes below 3000 that a ``Bye`` may carry (RFC 6455 7.4)."""
STORE_SUBPROTOCOL: Final = "pica.store.1"
"""The websocket sub-protocol of uploads; the digit changes when old peers could not follow."""
AVATARS_PATH: Final = "/avatars/"
"""Where files are got by HTTP; an id follows."""
MAX_OFFER_BYTES: Final = 2**40
"""What an offer can say; the relay's own limit is far below."""
Check = Callable[[str, Any], None]
"""Takes the name of a field and its value; raises ``ValueError``."""


def _within(low: int, high: int) -> Check:
    """Limit an integer."""
    return lambda name, value: limits.check_range(name, value, low, high)


def _text(max_bytes: int, *, required: bool = False) -> Check:
    return lambda name, value: limits.check_text(name, value, max_bytes, required=required)


def _if_any(check: Check) -> Check:
    """Check a value that is neither empty nor None."""
    return lambda name, value: check(name, value) if value else None


def _at_most(limit: int, what: str = "items") -> Check:
    return lambda name, items: limits.check_count(name, items, limit, what)


def _tracks(lowest: int, highest: int) -> Check:
    """Limit tracks in their number, and their streams."""

    def check(name: str, tracks: tuple["Track", ...]) -> None:
        limits.check_count(name, tracks, limits.MAX_TRACKS)
        for track in tracks:
            limits.check_range(f"{name}.stream", track.stream, lowest, highest)

    return check


def _one_of(choices: tuple[object, ...]) -> Check:
    def check(name: str, value: object) -> None:
        if value not in choices:
            raise ValueError(f"{name} must be one of {choices}, got {limits.quoted(value)}")

    return check


def _close_code(name: str, code: int) -> None:
    if code not in BYE_CODES and not 3000 <= code <= 4999:
        raise ValueError(f"{name} must be one a close frame may carry, got {code}")


Token = Annotated[str, limits.check_token]
Sha256 = Annotated[str, limits.check_sha256]
Pass = Annotated[str, limits.check_pass]
Name = Annotated[str, _text(limits.MAX_NAME_BYTES)]
Reason = Annotated[str, _text(limits.MAX_REASON_BYTES)]
Said = Annotated[Metadata, limits.check_metadata]
Stream = Annotated[int, _within(1, limits.MAX_STREAM)]
Kind = Annotated[str, limits.check_token, _text(MAX_TRACK_KIND_BYTES)]


def wire_name(cls: type) -> str:
    """The name of a record on the wire and in errors: that of its class, with underscores."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", cls.__name__).lower()


@functools.cache
def _checks(cls: type) -> tuple[tuple[str, str, Check], ...]:
    """Field, its name in errors, and check, for all limits in the annotations of a record."""
    return tuple(
        (name, f"{wire_name(cls)}.{name}", check)
        for name, hint in get_type_hints(cls, include_extras=True).items()
        for check in getattr(hint, "__metadata__", ())
    )


class Checked:
    """A record that holds its fields against the limits in their annotations when it is made.

    Raises:
        ValueError: A field is out of its limits; names it, its value and the limit.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        cls: type = type(self)
        for name, said, check in _checks(cls):
            check(said, getattr(self, name))


@dataclass(frozen=True, kw_only=True, slots=True)
class Track(Checked):
    """One thing a peer publishes. The relay looks at ``stream`` and ``deadline_ms`` only."""

    kind: Kind
    """What the payloads are, for receivers: ``face`` today. A short word of a-z, 0-9, _ . -"""
    avatar: Sha256 = ""
    """SHA-256 of the avatar file a receiver needs to draw this track, in hexadecimal, or empty."""
    stream: Annotated[int, _within(0, limits.MAX_STREAM)] = 0
    """The stream its frames travel on; 0 in ``Join``, allotted by the relay in ``Joined``."""
    deadline_ms: Annotated[int, _within(0, limits.MAX_DEADLINE_MS)] = 0
    """How long a frame of an ordered track may wait for a receiver that is slow, milliseconds. 0:
    it is not ordered, and all frames but the newest may be dropped, see `frame_queue`."""

    @property
    def deadline_s(self) -> float | None:
        """How long a frame may wait, seconds; None: until the next one comes."""
        return self.deadline_ms / 1000 if self.deadline_ms else None


@dataclass(frozen=True, kw_only=True, slots=True)
class Peer(Checked):
    """A peer in the room, as the others see it."""

    peer_id: Token
    """Opaque, unique in the room for its lifetime; made by the relay."""
    name: Annotated[str, _text(limits.MAX_NAME_BYTES, required=True)]
    """What the person is called; not unique, and a mere claim unless ``is_name_assured``."""
    tracks: Annotated[tuple[Track, ...], _tracks(1, limits.MAX_STREAM)] = ()
    metadata: Said = ()
    """What it says of itself; not to be trusted."""
    identity: Annotated[str, _if_any(limits.check_token)] = ""
    """The identity in the token that it joined with; empty without tokens."""
    is_name_assured: bool = False
    """Whether the name stands in that token, and is not what its owner would like to be called."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Join(Checked):
    """First message of a client: asks for a place in a room, naming what this client will publish
    (nothing: a mere viewer)."""

    room: Token
    name: Annotated[str, limits.check_name]
    tracks: Annotated[tuple[Track, ...], _tracks(0, 0)] = ()
    token: Pass = field(default="", repr=False)
    """Proof that its owner may come in, where the relay wants one; a secret."""
    metadata: Said = ()
    """What this client says of itself."""
    resumable: bool = False
    """Whether it comes back when the connection breaks: its place is kept for a while."""
    resume: Pass = field(default="", repr=False)
    """The secret of the last ``Joined``, which opens the place again if that is still there."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Joined(Checked):
    """The place in the room: own id, own tracks with their streams, and everybody present."""

    room: Token
    peer_id: Token
    tracks: Annotated[tuple[Track, ...], _tracks(1, limits.MAX_STREAM)] = ()
    """The tracks of the ``Join`` in the same order, each with its stream."""
    peers: Annotated[tuple[Peer, ...], _at_most(limits.MAX_PEERS)] = ()
    """The others who are here already."""
    resumed: bool = False
    """Whether this is the old place: own id and streams are those of before, and the others have
    seen no peer come or go."""
    resume: Pass = field(default="", repr=False)
    """What to come back with, once; empty: the place is not kept. A secret."""
    name: Annotated[str, _text(limits.MAX_NAME_BYTES)] = ""
    """What the others are shown, where the token says it; empty: the name of the ``Join``."""
    is_admin: bool = False
    """Whether the token has the grant ``admin``: this client may moderate the room."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerJoined(Checked):
    """A peer came in."""

    peer: Peer


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerLeft(Checked):
    """A peer went, on purpose or not. Its streams end with it."""

    peer_id: Token
    reason: Reason = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerAway(Checked):
    """A peer lost the connection and may come back: its place and streams are kept. Or it has come
    back on a new one, also without having been away."""

    peer_id: Token
    is_away: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerUpdated(Checked):
    """A peer says something else of itself."""

    peer_id: Token
    metadata: Said = ()
    """All of it: it replaces what was said before."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamMuted(Checked):
    """An admin has stopped a stream, or lets it go on; the publisher is told too."""

    stream: Stream
    is_muted: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class UpdateMetadata(Checked):
    """A client says something else of itself; the relay tells the others with ``PeerUpdated``."""

    metadata: Said = ()
    """All of it: it replaces what was said before."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Subscribe(Checked):
    """How much of one stream a receiver wants. Without one it gets everything."""

    stream: Stream
    every: Annotated[int, _one_of(SHARES)] = 1
    """1: every frame; 2 or 4: those whose sequence number is a multiple of it; 0: none."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Whisper(Checked):
    """Opaque bytes for one peer in the room; the relay does not look into them.

    On its way to the relay it names the receiver, on its way from the relay the sender.
    """

    peer_id: Token
    data: Annotated[bytes, _at_most(limits.MAX_WHISPER_BYTES, "bytes")]


@dataclass(frozen=True, kw_only=True, slots=True)
class RemovePeer(Checked):
    """An admin removes a participant from the room; their token still lets them join again."""

    peer_id: Token


@dataclass(frozen=True, kw_only=True, slots=True)
class MutePeer(Checked):
    """An admin stops what a participant sends of one kind, or lets it go on. Everybody is told with
    ``StreamMuted``."""

    peer_id: Token
    kind: Kind
    """The kind of track, as ``face`` or ``voice``."""
    is_muted: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class BarIdentity(Checked):
    """An admin removes an identity and keeps it out until the room is empty, or lets it join
    again."""

    identity: Token
    """The identity in the participant's token, see ``Peer``."""
    is_barred: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Bye(Checked):
    """Last message of either side; the websocket close frame repeats code and reason."""

    code: Annotated[int, _close_code]
    reason: Reason = ""
    url: Annotated[str, limits.check_url] = ""
    """Another relay, where the same join will be taken; a client may try there at once."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Offer(Checked):
    """First message of an upload: which file comes."""

    sha256: Annotated[str, limits.check_sha256, _text(64, required=True)]
    """SHA-256 of the file's bytes, in hexadecimal: its id."""
    size: Annotated[int, _within(1, MAX_OFFER_BYTES)]
    """Its length in bytes."""
    token: Pass = field(default="", repr=False)
    """A join token that allows to publish with this avatar; a relay with keys wants one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Ready(Checked):
    """The relay does not have it: send it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Stored(Checked):
    """The relay has it, and anyone who knows its id can get it."""

    is_new: bool = False
    """Whether it has come with this upload; false: it was there already."""


RoomNews = PeerJoined | PeerLeft | PeerAway | PeerUpdated | StreamMuted | Whisper
"""What a relay says to the members of a room."""
Moderation = RemovePeer | MutePeer | BarIdentity
"""What only an admin says to the relay."""
FromMember = Subscribe | Whisper | UpdateMetadata | Moderation
"""What a member of a room says to the relay."""
StoreMessage = Offer | Ready | Stored
Message = Join | Joined | Bye | RoomNews | FromMember | StoreMessage

MESSAGE_TYPES: Final = cast(
    "dict[str, type[Message]]", {wire_name(cls): cls for cls in get_args(Message)}
)
"""The name each message has on the wire, in its ``type`` field."""
