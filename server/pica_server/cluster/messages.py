"""What the nodes of a cluster tell each other, as bytes: records, subscriptions, requests, media.

All of it travels on NATS, which only nodes may use; it is checked all the same, and what cannot be
read is dropped and counted. Rooms are named by a hash, so that no name stands in a subject. A
record holds the names and identities that peers show each other.

    record    version, writer, members: (node, PeerJoined as on the wire, away, muted), farewells
    interest  which streams of the receiving node the sending node wants, up to which layer
    ask       a keyframe is wanted of a stream of the receiving node
    order     an admin wants something of the receiving node
    whisper   opaque bytes for a peer of the receiving node
    media     16-byte header, then a media message as on the websocket: kind 2 and frames
"""

import hashlib
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import msgpack

from pica_protocol import limits
from pica_protocol.codec import decode_message, encode_message, refuse_extension, unique_keys
from pica_protocol.errors import ProtocolError
from pica_protocol.messages import Peer, PeerJoined, Whisper
from pica_server.errors import ClusterMessageError

VERSION: Final = 2
NUM_SLOTS: Final = 128
"""Nodes of one cluster: each allots streams from a part of the numbers that is its own."""
STREAMS_PER_SLOT: Final = (limits.MAX_STREAM + 1) // NUM_SLOTS
MAX_RECORD_BYTES: Final = 1_000_000
"""One room as it is kept; a message of NATS takes 1 MiB by default."""
_MAX_ITEMS: Final = 4096
_MEDIA_HEADER: Final = struct.Struct(">BBHIQ")
MEDIA_HEADER_BYTES: Final = _MEDIA_HEADER.size


class NodeId(NamedTuple):
    """One run of one node."""

    slot: int
    """Its place in the cluster, 0..127: nobody else's while it lives."""
    run: str
    """Chosen at random when it got its slot."""

    @property
    def name(self) -> str:
        """Return what stands for it in records."""
        return f"{self.slot}-{self.run}"


def slot_of(node: str) -> int:
    """Return the slot in a node's name.

    Raises:
        ClusterMessageError: It is no name of a node.
    """
    slot, dash, run = node.partition("-")
    if not dash or not run.isalnum() or not slot.isdigit() or int(slot) >= NUM_SLOTS:
        raise ClusterMessageError("no name of a node")
    return int(slot)


@dataclass(frozen=True, slots=True)
class Member:
    """Somebody in a room, and where."""

    node: str
    peer: Peer
    is_away: bool = False
    """Its connection is lost, and it may come back."""
    muted: tuple[int, ...] = ()
    """Its streams that an admin has stopped."""

    def is_same_person(self, other: "Member") -> bool:
        """Say whether both have the same identity."""
        return bool(self.peer.identity) and self.peer.identity == other.peer.identity


@dataclass(frozen=True, slots=True)
class Record:
    """Who is in a room, in the order of their coming: what all nodes agree on."""

    members: tuple[Member, ...] = ()
    farewells: Mapping[str, str] = field(default_factory=dict)
    """Why those have gone who were in the record before this one: peer id to a word."""
    writer: str = ""
    """The node that wrote it."""


@dataclass(frozen=True, slots=True)
class Interest:
    """What a node wants of the others in a room."""

    room: str
    node: str
    number: int
    """Counts what this node says about this room; an older one that comes late is ignored."""
    epoch: int
    """A new one asks for all wanted streams from a keyframe on: something was lost."""
    revision: int
    """The revision of the record that the node knows."""
    wants_answer: bool
    """The node does not know what the receiver wants."""
    layers: Mapping[int, int] = field(default_factory=dict)
    """Stream to highest layer; a stream that is missing is not wanted."""


@dataclass(frozen=True, slots=True)
class Ask:
    """A keyframe is wanted."""

    room: str
    stream: int
    why: str


@dataclass(frozen=True, slots=True)
class Order:
    """An admin wants something done on another node."""

    room: str
    what: str
    """``remove`` a peer, ``mute`` or ``unmute`` a stream, ``bar`` or ``unbar`` an identity."""
    target: str
    """The peer id, the number of the stream, or the identity."""


@dataclass(frozen=True, slots=True)
class Passed:
    """A whisper on its way to the node of its receiver."""

    room: str
    sender: str
    whisper: Whisper


NodeMessage = Interest | Ask | Order | Passed


class MediaHeader(NamedTuple):
    """What stands before the frames of one media message between nodes."""

    slot: int
    """The sending node's."""
    epoch: int
    """The number of the receiver's interest that this answers."""
    number: int
    """Counts the messages of the epoch: a hole is a loss."""


def room_key(room: str) -> str:
    """Return what stands for a room in subjects and keys."""
    return hashlib.sha256(b"pica room\0" + room.encode()).hexdigest()[:32]


def encode_record(record: Record) -> bytes:
    """Return a record as it is kept."""
    members = [
        [m.node, encode_message(PeerJoined(peer=m.peer)), m.is_away, list(m.muted)]
        for m in record.members
    ]
    return _pack([VERSION, record.writer, members, dict(record.farewells)])


def decode_record(data: bytes) -> Record:
    """Read a record; nothing at all is the record of an empty room.

    Raises:
        ClusterMessageError: It is none, or of another version.
    """
    if not data:
        return Record()
    version, writer, members, farewells = _unpack(data, MAX_RECORD_BYTES, 4)
    if version != VERSION:
        raise ClusterMessageError("record of another version: run the same release on all nodes")
    if not isinstance(members, list):
        raise ClusterMessageError("malformed members of a record")
    if not isinstance(farewells, dict):
        raise ClusterMessageError("malformed farewells of a record")
    slot_of(_text(writer))
    return Record(
        tuple(map(_read_member, members)),
        {_text(peer_id): _text(word) for peer_id, word in farewells.items()},
        writer,
    )


def encode_node_message(message: NodeMessage) -> bytes:
    """Return a message from node to node."""
    match message:
        case Interest():
            flags = [message.epoch, message.revision, message.wants_answer]
            layers = dict(message.layers)
            return _pack(["interest", message.room, message.node, message.number, flags, layers])
        case Ask():
            return _pack(["ask", message.room, message.stream, message.why])
        case Order():
            return _pack(["order", message.room, message.what, message.target])
        case Passed(room=room, sender=sender, whisper=whisper):
            return _pack(["whisper", room, sender, encode_message(whisper)])


def decode_node_message(data: bytes) -> NodeMessage:
    """Read a message from node to node.

    Raises:
        ClusterMessageError: It is none.
    """
    kind, *rest = _unpack(data, limits.MAX_CONTROL_BYTES)
    try:
        if kind == "interest":
            room, node, number, (epoch, revision, wants_answer), layers = rest
            slot_of(_text(node))
            return Interest(
                _text(room),
                node,
                _count(number),
                _count(epoch),
                _count(revision),
                bool(wants_answer),
                {
                    _count(s, limits.MAX_STREAM): _count(n, limits.MAX_LAYER)
                    for s, n in layers.items()
                },
            )
        if kind == "ask":
            room, stream, why = rest
            return Ask(_text(room), _count(stream, limits.MAX_STREAM), _text(why))
        if kind == "order":
            room, what, target = rest
            return Order(_text(room), _text(what), _text(target))
        if kind == "whisper":
            room, sender, body = rest
            limits.check_token("sender", _text(sender))
            whisper = decode_message(_bytes(body))
            if isinstance(whisper, Whisper):
                return Passed(_text(room), sender, whisper)
    except (ValueError, TypeError, AttributeError, ProtocolError) as error:
        raise ClusterMessageError(f"malformed {_text(kind)[:16]}") from error
    raise ClusterMessageError("a message of an unknown kind")


def encode_media(header: MediaHeader, message: bytes) -> bytes:
    """Put the header before a media message."""
    return _MEDIA_HEADER.pack(VERSION, header.slot, 0, header.epoch, header.number) + message


def decode_media_header(data: bytes) -> MediaHeader:
    """Read the header; the media message follows it.

    Raises:
        ClusterMessageError: It is too short or too long, or of another version.
    """
    if not MEDIA_HEADER_BYTES < len(data) <= MEDIA_HEADER_BYTES + limits.MAX_MEDIA_MESSAGE_BYTES:
        raise ClusterMessageError("media of a wrong size")
    version, slot, _, epoch, number = _MEDIA_HEADER.unpack_from(data)
    if version != VERSION:
        raise ClusterMessageError("media of another version")
    return MediaHeader(slot, epoch, number)


def _pack(value: object) -> bytes:
    packed: bytes = msgpack.packb(value)
    return packed


def _unpack(data: bytes, max_bytes: int, num_items: int | None = None) -> list[Any]:
    if len(data) > max_bytes:
        raise ClusterMessageError(f"a message of {len(data)} bytes")
    try:
        value = msgpack.unpackb(
            data,
            raw=False,
            strict_map_key=False,
            max_str_len=1024,
            max_bin_len=limits.MAX_CONTROL_BYTES,
            max_array_len=_MAX_ITEMS,
            max_map_len=_MAX_ITEMS,
            max_ext_len=0,
            ext_hook=refuse_extension,
            object_pairs_hook=unique_keys,
        )
    # A key that is a list is a TypeError, a timestamp out of range an OverflowError.
    except (ValueError, TypeError, OverflowError, RecursionError, msgpack.UnpackException) as error:
        raise ClusterMessageError("not a message of a node") from error
    if not isinstance(value, list) or not value or num_items not in (None, len(value)):
        raise ClusterMessageError("not a message of a node")
    return value


def _read_member(item: Any) -> Member:
    try:
        node, body, is_away, muted = item
        slot_of(_text(node))
        arrival = decode_message(_bytes(body))
        if not isinstance(arrival, PeerJoined):
            raise ValueError("no peer")
        streams = tuple(_count(stream, limits.MAX_STREAM) for stream in muted)
        return Member(node, arrival.peer, bool(is_away), streams)
    except (ValueError, TypeError, ProtocolError) as error:
        raise ClusterMessageError("malformed member of a record") from error


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise ClusterMessageError("a field that should be text")
    return value


def _bytes(value: object) -> bytes:
    if not isinstance(value, bytes):
        raise ClusterMessageError("a field that should be bytes")
    return value


def _count(value: object, limit: int = 2**63) -> int:
    if not isinstance(value, int):
        raise ClusterMessageError("a field that should be a number")
    limits.check_range("number", value, 0, limit)
    return value
