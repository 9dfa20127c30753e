"""The control messages: frozen records that check their own limits.

Direction and bytes of each are shown in ``docs/protocol.md``. The annotations are the schema that
``codec.py`` reads: ``int``, ``bool``, ``str``, ``bytes``, ``int | None``, another record, a tuple
of one of these, or ``Metadata``. A later version may add a field with a default; it never reorders,
retypes or removes one. A field made by ``_added`` travels only where it is not its default, so the
bytes of a message without it stay those of before.
"""

from dataclasses import dataclass, field
from typing import Any, Final

from pica_protocol import PROTOCOL_VERSION
from pica_protocol.limits import (
    MAX_DEADLINE_MS,
    MAX_LAYER,
    MAX_NAME_BYTES,
    MAX_PEERS,
    MAX_REASON_BYTES,
    MAX_REPORT_STREAMS,
    MAX_STREAM,
    MAX_TRACKS,
    MAX_WHISPER_BYTES,
    check_bytes,
    check_count,
    check_metadata,
    check_name,
    check_pass,
    check_range,
    check_sha256,
    check_text,
    check_token,
    check_url,
    quoted,
)

MAX_COUNTER: Final = 2**63 - 1
MAX_TRACK_KIND_BYTES: Final = 16
DROP_POLICIES: Final = ("latest", "ordered")
"""What may be dropped when a receiver is slow. ``latest``: whatever newer frames make needless, see
`stream_queue`. ``ordered``: what has waited longer than its deadline, see `ordered_queue`."""
Metadata = tuple[tuple[str, str], ...]
"""What a peer says of itself, a few short texts by key; a map on the wire."""
BYE_CODES: Final = (1000, 1001, 1009, 1011)
"""Codes below 3000 that a ``Bye`` may carry (RFC 6455 7.4)."""
LEFT_OUT: Final = "left out where it is the default"
"""Stands in the metadata of such a field."""


def _added(default: Any) -> Any:
    """Return a field that a later version has added."""
    return field(default=default, metadata={LEFT_OUT: True})


@dataclass(frozen=True, kw_only=True, slots=True)
class Track:
    """One thing a peer publishes. The relay looks at ``stream`` and ``policy`` only."""

    kind: str
    """What the payloads are, for receivers: ``face`` today. A short word of a-z, 0-9, _ . -"""
    policy: str = "latest"
    """Drop policy, one of ``DROP_POLICIES``."""
    avatar: str = ""
    """SHA-256 of the avatar file a receiver needs to draw this track, in hexadecimal, or empty."""
    stream: int = 0
    """The stream its frames travel on; 0 in ``Join``, allotted by the relay in ``Joined``."""
    profile: str = ""
    """SHA-256 of the stream profile the payloads are encoded with, in hexadecimal; empty: plain."""
    deadline_ms: int = 0
    """Says, with ``ordered``, how long a frame may wait for a receiver, milliseconds; else 0."""

    def __post_init__(self) -> None:
        check_token("track.kind", self.kind)
        check_text("track.kind", self.kind, MAX_TRACK_KIND_BYTES)
        if self.policy not in DROP_POLICIES:
            raise ValueError(
                f"track.policy must be one of {DROP_POLICIES}, got {quoted(self.policy)}"
            )
        check_sha256("track.avatar", self.avatar)
        check_range("track.stream", self.stream, 0, MAX_STREAM)
        check_sha256("track.profile", self.profile)
        is_ordered = self.policy == "ordered"
        longest_ms = MAX_DEADLINE_MS if is_ordered else 0
        check_range("track.deadline_ms", self.deadline_ms, int(is_ordered), longest_ms)


@dataclass(frozen=True, kw_only=True, slots=True)
class Peer:
    """Somebody in the room, as the others see them."""

    peer_id: str
    """Opaque, unique in the room for its lifetime; made by the relay."""
    name: str
    """What the person is called; not unique, and a mere claim unless ``is_name_assured``."""
    tracks: tuple[Track, ...] = ()
    metadata: Metadata = ()
    """What it says of itself; not to be trusted."""
    identity: str = _added("")
    """Who it is by the token that it came in with; empty without tokens."""
    is_name_assured: bool = _added(False)
    """Whether the name stands in that token, and is not what its owner would like to be called."""

    def __post_init__(self) -> None:
        if self.identity:
            check_token("peer.identity", self.identity)
        check_token("peer.peer_id", self.peer_id)
        check_metadata("peer.metadata", self.metadata)
        check_text("peer.name", self.name, MAX_NAME_BYTES, required=True)
        check_count("peer.tracks", self.tracks, MAX_TRACKS)
        for track in self.tracks:
            check_range("peer.tracks.stream", track.stream, 1, MAX_STREAM)


@dataclass(frozen=True, kw_only=True, slots=True)
class Hello:
    """First message of a client."""

    version: int = PROTOCOL_VERSION
    software: str = ""

    def __post_init__(self) -> None:
        check_range("hello.version", self.version, 0, MAX_COUNTER)
        check_text("hello.software", self.software, MAX_NAME_BYTES)


@dataclass(frozen=True, kw_only=True, slots=True)
class Welcome:
    """The relay's answer to ``Hello``."""

    version: int = PROTOCOL_VERSION
    software: str = ""

    def __post_init__(self) -> None:
        check_range("welcome.version", self.version, 0, MAX_COUNTER)
        check_text("welcome.software", self.software, MAX_NAME_BYTES)


@dataclass(frozen=True, kw_only=True, slots=True)
class Join:
    """Ask for a place in a room, naming what this client will publish (nothing: a mere viewer)."""

    room: str
    name: str
    tracks: tuple[Track, ...] = ()
    token: str = field(default="", repr=False)
    """Proof that its owner may come in, where the relay wants one; a secret."""
    metadata: Metadata = ()
    """What this client says of itself."""
    resumable: bool = False
    """Whether it comes back when the connection breaks: its place is kept for a while."""
    resume: str = field(default="", repr=False)
    """The secret of the last ``Joined``, which opens the place again if that is still there."""

    def __post_init__(self) -> None:
        check_token("join.room", self.room)
        check_pass("join.token", self.token)
        check_pass("join.resume", self.resume)
        check_metadata("join.metadata", self.metadata)
        check_name("join.name", self.name)
        check_count("join.tracks", self.tracks, MAX_TRACKS)
        for track in self.tracks:
            check_range("join.tracks.stream", track.stream, 0, 0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Joined:
    """The place in the room: own id, own tracks with their streams, and everybody present."""

    room: str
    peer_id: str
    tracks: tuple[Track, ...] = ()
    """The tracks of the ``Join`` in the same order, each with its stream."""
    peers: tuple[Peer, ...] = ()
    """The others who are here already."""
    resumed: bool = False
    """Whether this is the old place: own id and streams are those of before, and the others have
    seen nobody come or go."""
    resume: str = field(default="", repr=False)
    """What to come back with, once; empty: the place is not kept. A secret."""
    resume_ms: int = 0
    """How long the place is kept after the connection broke, milliseconds."""
    name: str = _added("")
    """What the others are shown, where the token says it; empty: the name of the ``Join``."""

    def __post_init__(self) -> None:
        check_text("joined.name", self.name, MAX_NAME_BYTES)
        check_token("joined.room", self.room)
        check_token("joined.peer_id", self.peer_id)
        check_count("joined.tracks", self.tracks, MAX_TRACKS)
        for track in self.tracks:
            check_range("joined.tracks.stream", track.stream, 1, MAX_STREAM)
        check_count("joined.peers", self.peers, MAX_PEERS)
        check_pass("joined.resume", self.resume)
        check_range("joined.resume_ms", self.resume_ms, 0, MAX_COUNTER)


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerJoined:
    """Somebody came in."""

    peer: Peer


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerLeft:
    """Somebody went, on purpose or not. Their streams end with it."""

    peer_id: str
    reason: str = ""

    def __post_init__(self) -> None:
        check_token("peer_left.peer_id", self.peer_id)
        check_text("peer_left.reason", self.reason, MAX_REASON_BYTES)


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerAway:
    """Somebody lost the connection and may come back: their seat and streams are kept."""

    peer_id: str

    def __post_init__(self) -> None:
        check_token("peer_away.peer_id", self.peer_id)


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerBack:
    """Somebody has come back on a new connection; also without a ``PeerAway`` before it."""

    peer_id: str

    def __post_init__(self) -> None:
        check_token("peer_back.peer_id", self.peer_id)


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerUpdated:
    """Somebody says something else of themselves."""

    peer_id: str
    metadata: Metadata = ()
    """All of it: it replaces what was said before."""

    def __post_init__(self) -> None:
        check_token("peer_updated.peer_id", self.peer_id)
        check_metadata("peer_updated.metadata", self.metadata)


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamMuted:
    """An admin has stopped a stream, or lets it go on; the publisher is told too."""

    stream: int
    is_muted: bool

    def __post_init__(self) -> None:
        check_range("stream_muted.stream", self.stream, 1, MAX_STREAM)


@dataclass(frozen=True, kw_only=True, slots=True)
class UpdateMetadata:
    """A client says something else of itself; the relay tells the others with ``PeerUpdated``."""

    metadata: Metadata = ()
    """All of it: it replaces what was said before."""

    def __post_init__(self) -> None:
        check_metadata("update_metadata.metadata", self.metadata)


@dataclass(frozen=True, kw_only=True, slots=True)
class Leave:
    """A client goes; the relay answers ``Bye`` with code 1000 and closes."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Want:
    """A receiver's subscription to one stream: frames up to ``layer``, or none.

    Without one it gets everything.
    """

    stream: int
    layer: int | None = None
    """Highest layer to forward; None stops the stream."""

    def __post_init__(self) -> None:
        check_range("want.stream", self.stream, 1, MAX_STREAM)
        if self.layer is not None:
            check_range("want.layer", self.layer, 0, MAX_LAYER)


@dataclass(frozen=True, kw_only=True, slots=True)
class KeyframeRequest:
    """A receiver asks for a keyframe; the relay passes it on to the publisher at a limited rate."""

    stream: int

    def __post_init__(self) -> None:
        check_range("keyframe_request.stream", self.stream, 1, MAX_STREAM)


@dataclass(frozen=True, kw_only=True, slots=True)
class Whisper:
    """Opaque bytes for one peer in the room; the relay does not look into them.

    On its way to the relay it names the receiver, on its way from the relay the sender.
    """

    peer_id: str
    data: bytes

    def __post_init__(self) -> None:
        check_token("whisper.peer_id", self.peer_id)
        check_bytes("whisper.data", self.data, MAX_WHISPER_BYTES)


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamReport:
    """How one stream arrived since the last report."""

    stream: int
    received: int
    lost: int = 0
    """Holes in the sequence: dropped by the relay, or never sent."""
    concealed: int = 0
    """Display times for which there was no fresh frame."""

    def __post_init__(self) -> None:
        check_range("report.stream", self.stream, 1, MAX_STREAM)
        for counter, value in (
            ("received", self.received),
            ("lost", self.lost),
            ("concealed", self.concealed),
        ):
            check_range(f"report.{counter}", value, 0, MAX_COUNTER)


@dataclass(frozen=True, kw_only=True, slots=True)
class Report:
    """What a receiver saw, for the relay's statistics."""

    streams: tuple[StreamReport, ...] = ()

    def __post_init__(self) -> None:
        check_count("report.streams", self.streams, MAX_REPORT_STREAMS)


@dataclass(frozen=True, kw_only=True, slots=True)
class Bye:
    """Last message of either side; the websocket close frame repeats code and reason."""

    code: int
    reason: str = ""
    url: str = ""
    """Another relay, where the same join will be taken; a client may try there at once."""

    def __post_init__(self) -> None:
        if self.code not in BYE_CODES and not 3000 <= self.code <= 4999:
            raise ValueError(f"bye.code must be one a close frame may carry, got {self.code}")
        check_text("bye.reason", self.reason, MAX_REASON_BYTES)
        check_url("bye.url", self.url)


Message = (
    Hello
    | Welcome
    | Join
    | Joined
    | PeerJoined
    | PeerLeft
    | PeerAway
    | PeerBack
    | PeerUpdated
    | StreamMuted
    | UpdateMetadata
    | Leave
    | Want
    | KeyframeRequest
    | Report
    | Whisper
    | Bye
)

MESSAGE_TYPES: Final[dict[str, type[Message]]] = {
    "hello": Hello,
    "welcome": Welcome,
    "join": Join,
    "joined": Joined,
    "peer_joined": PeerJoined,
    "peer_left": PeerLeft,
    "peer_away": PeerAway,
    "peer_back": PeerBack,
    "peer_updated": PeerUpdated,
    "stream_muted": StreamMuted,
    "update_metadata": UpdateMetadata,
    "leave": Leave,
    "want": Want,
    "keyframe_request": KeyframeRequest,
    "report": Report,
    "whisper": Whisper,
    "bye": Bye,
}
"""The name each message has on the wire, in its ``type`` field."""
