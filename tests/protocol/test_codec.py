import contextlib
import tracemalloc

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.strategies import messages
from pica_protocol.codec import (
    MAX_CHUNK_BYTES,
    decode_chunk,
    decode_message,
    encode_chunk,
    encode_message,
)
from pica_protocol.errors import RemoteProtocolError
from pica_protocol.limits import MAX_CONTROL_BYTES, MAX_PEERS, is_avatar_id
from pica_protocol.messages import Joined, Message, Offer, Peer, Ready, Track

pytestmark = pytest.mark.unit


def pack(value: object) -> bytes:
    return b"\x01" + bytes(msgpack.packb(value))


@given(messages)
def test_every_message_survives_the_wire(message: Message) -> None:
    assert decode_message(encode_message(message)) == message


@pytest.mark.parametrize(
    "bomb",
    [
        b"\x01" + b"\x91" * 60_000,
        b"\x01" + b"\xdd\xff\xff\xff\xff" + b"\xc0" * 10_000,
        b"\x01" + b"\xdf\xff\xff\xff\xff" + b"\xc0" * 10_000,
        b"\x01" + b"\xdb\xff\xff\xff\xff" + b"x" * 10_000,
        b"\x01" + b"\xdc\xff\xff" * 3000,
        b"\x01" + b"\xc7\x00\x05",
        b"\x01" + b"\xd6\xff\x00\x00\x00\x00",
        b"\x01" + (b"\x81" + b"\x81" * 500) * 100,
    ],
    ids=["nesting", "array", "map", "text", "arrays", "extension", "timestamp", "map keys"],
)
def test_a_msgpack_bomb_is_refused_within_a_megabyte(bomb: bytes) -> None:
    tracemalloc.start()
    with pytest.raises(RemoteProtocolError):
        decode_message(bomb)
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak_bytes < 1_000_000


def test_a_message_above_the_size_limit_is_refused_before_it_is_decoded() -> None:
    with pytest.raises(RemoteProtocolError, match="the limit is 100"):
        decode_message(pack({"type": "ready"}).ljust(101, b"\0"), max_bytes=100)


def test_unknown_fields_are_ignored_so_that_later_versions_may_add_some() -> None:
    assert decode_message(pack({"type": "ready", "colour": [1, {}]})) == Ready()


@pytest.mark.parametrize(
    ("record", "complaint"),
    [
        ({"type": "subscribe"}, "subscribe.stream is missing"),
        ({"type": "subscribe", "stream": "3"}, "subscribe.stream must be an integer, got '3'"),
        ({"type": "subscribe", "stream": True}, "subscribe.stream must be an integer, got True"),
        ({"type": "subscribe", "stream": 0}, "subscribe.stream must be in 1..65535, got 0"),
        ({"type": "subscribe", "stream": 1, "every": 3}, "subscribe.every must be one of"),
        ({"type": "peer_joined", "peer": 5}, "peer_joined.peer must be a map, got 5"),
        (
            {"type": "join", "room": "r", "name": "n", "tracks": [{"kind": 1}]},
            r"join.tracks\[0\].kind must be text, got 1",
        ),
        ({"type": "join", "room": "../etc", "name": "n"}, "join.room must be 1..64 of"),
        ({"type": "join", "room": "r", "name": "\x1b[2J"}, "join.name must be printable"),
        ({"type": "bye", "code": 1006}, "bye.code must be one a close frame may carry, got 1006"),
        *(
            ({"type": "bye", "code": 1001, "url": url}, r"bye.url must be empty or ws\[s\]://HOST")
            for url in (
                "http://a",
                "ws://",
                "ws://a:b@c",
                "ws://a b",
                "ws://[:]",
                "ws://a:99999",
                "wss://a/" + "b" * 249,
            )
        ),
        (
            {"type": "update_metadata", "metadata": {"k": 1}},
            "update_metadata.metadata.'k' must be text, got 1",
        ),
        (
            {"type": "update_metadata", "metadata": {b"k": "v"}},
            "update_metadata.metadata key must be text, got b'k'",
        ),
        (
            {"type": "update_metadata", "metadata": {str(i): "" for i in range(9)}},
            "update_metadata.metadata must have at most 8 items, got 9",
        ),
        (
            {
                "type": "join",
                "room": "r",
                "name": "n",
                "tracks": [{"kind": "k", "deadline_ms": 10_001}],
            },
            r"track.deadline_ms must be in 0..10000, got 10001",
        ),
        (
            {"type": "stream_muted", "stream": 1, "is_muted": 1},
            "stream_muted.is_muted must be true or false, got 1",
        ),
        ({"type": "offer", "sha256": "0f" * 32, "size": 0}, r"offer.size must be in 1\.\."),
        ({"type": "poke"}, "unknown message type 'poke'"),
        ({}, "unknown message type None"),
        ([], "expected a map, got list"),
        ({"type": "subscribe", "stream": "x" * 1000}, "subscribe.stream"),
    ],
)
def test_a_bad_field_is_refused_with_its_path_value_and_limit(
    record: object, complaint: str
) -> None:
    with pytest.raises(RemoteProtocolError, match=complaint) as caught:
        decode_message(pack(record))
    assert len(str(caught.value)) < 500  # whoever sends it cannot fill the log


def test_the_fullest_room_fits_a_control_message() -> None:
    track = Track(kind="k" * 16, avatar="f" * 64, stream=65_535, deadline_ms=10_000)
    metadata = tuple((f"{i}" * 16, "x" * 64) for i in range(8))
    peer = Peer(
        peer_id="p" * 64,
        name="n" * 64,
        tracks=(track,) * 4,
        metadata=metadata,
        identity="i" * 64,
        is_name_assured=True,
    )
    joined = Joined(
        room="r" * 64,
        peer_id="p" * 64,
        tracks=(track,) * 4,
        peers=(peer,) * MAX_PEERS,
        resumed=True,
        resume="s" * 64,
        name="n" * 64,
    )
    assert len(encode_message(joined)) <= MAX_CONTROL_BYTES


ID = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"


@given(st.binary(max_size=200))
def test_any_bytes_are_a_chunk_or_refused(data: bytes) -> None:
    with contextlib.suppress(RemoteProtocolError):
        assert encode_chunk(decode_chunk(data)) == data


@pytest.mark.parametrize(
    "text",
    ["", ID[:-1], ID + "0", ID.upper(), ID[:-1] + "/", "../" + ID[3:], ID + "\n", ID[:-1] + "\x00"],
)
def test_only_64_lower_case_hexadecimal_digits_are_an_id(text: str) -> None:
    assert is_avatar_id(ID)
    assert not is_avatar_id(text)
    with pytest.raises(ValueError, match=r"offer\.sha256 must"):
        Offer(sha256=text, size=1)


@pytest.mark.parametrize("size", [0, MAX_CHUNK_BYTES + 1])
def test_a_chunk_has_a_size_that_fits_one_message(size: int) -> None:
    with pytest.raises(ValueError, match=r"a chunk has 1\.\."):
        encode_chunk(bytes(size))
    with pytest.raises(RemoteProtocolError, match="a chunk of"):
        decode_chunk(b"\x03" + bytes(size))
