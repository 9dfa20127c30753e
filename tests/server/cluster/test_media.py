"""Frames between two nodes: once, only what is wanted, and whole again after a loss."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_protocol.frames import FLAG_KEYFRAME, Frame, decode_media, encode_frame
from pica_protocol.limits import MAX_STREAM
from pica_protocol.messages import Peer, Track, Whisper
from pica_protocol.stream_queue import Put
from pica_server.cluster.media import ANNOUNCE_S, EPOCH_INTERVAL_S, Exchange, NodeLink
from pica_server.cluster.messages import (
    MEDIA_HEADER_BYTES,
    Ask,
    Interest,
    MediaHeader,
    Member,
    Passed,
    Record,
    decode_media_header,
    decode_node_message,
    decode_record,
    encode_media,
    encode_node_message,
    encode_record,
    room_key,
    slot_of,
)
from pica_server.errors import ClusterMessageError
from pica_server.room.outbox import ArrivedFrame

pytestmark = pytest.mark.unit

ROOM = room_key("lobby")


def frame(stream: int, sequence: int, *, is_keyframe: bool = False, layer: int = 0) -> bytes:
    return encode_frame(
        Frame(
            stream=stream,
            sequence=sequence,
            captured_us=0,
            payload=b"%d" % sequence,
            layer=layer,
            is_keyframe=is_keyframe,
        )
    )


def link() -> NodeLink:
    made = NodeLink("2-b", 1, ROOM, Counter())
    made.restart(7)
    return made


def put(to: NodeLink, stream: int, sequence: int, *, is_keyframe: bool = False) -> Put | None:
    data = frame(stream, sequence, is_keyframe=is_keyframe)
    return to.put(ArrivedFrame(stream, data, 0, FLAG_KEYFRAME if is_keyframe else 0, 0.0))


def test_a_node_gets_nothing_that_it_did_not_ask_for() -> None:
    other = link()
    assert put(other, 5, 0, is_keyframe=True) is None
    assert other.take(0.0) is None


def test_frames_of_several_streams_of_a_turn_leave_in_one_numbered_message() -> None:
    other = link()
    other.want(5, 2)
    other.want(6, 2)
    put(other, 5, 0, is_keyframe=True)
    put(other, 6, 0, is_keyframe=True)
    taken = other.take(0.0)
    assert taken is not None
    data, num_frames = taken
    assert num_frames == 2
    assert decode_media_header(data) == MediaHeader(1, 7, 0)
    assert [f.stream for f in decode_media(data[MEDIA_HEADER_BYTES:])] == [5, 6]
    put(other, 5, 1)
    taken = other.take(0.0)
    assert taken is not None
    assert decode_media_header(taken[0]).number == 1


def test_a_layer_above_what_the_node_wants_does_not_travel() -> None:
    other = link()
    other.want(5, 0)
    put(other, 5, 0, is_keyframe=True)
    assert other.put(ArrivedFrame(5, frame(5, 1, layer=1), 1, 0, 0.0)) is None
    taken = other.take(0.0)
    assert taken is not None
    assert taken[1] == 1


def test_a_node_that_nats_does_not_serve_is_owed_a_bounded_number_of_frames() -> None:
    other = link()
    other.want(5, 7)
    put(other, 5, 0, is_keyframe=True)
    for i in range(1, 1000):
        put(other, 5, i)
    assert other.outbox.waiting_frames < 110


def test_a_hole_in_the_numbers_asks_for_everything_from_a_keyframe_on_at_a_limited_rate() -> None:
    exchange = Exchange(ROOM, "2-b", 1)
    told = exchange.announce({5: 2}, 3, {"1-a"}, 2, 0.0)
    assert [(node, message.epoch, message.wants_answer) for node, message in told] == [
        ("1-a", 1, True)
    ]
    assert exchange.receive_header(MediaHeader(1, 1, 0))
    assert not exchange.receive_header(MediaHeader(1, 1, 2))
    assert not exchange.receive_header(MediaHeader(1, 1, 1)), "what comes late is not taken either"
    ((_, message),) = exchange.announce({5: 2}, 3, {"1-a"}, 2, 1.0)
    assert (message.epoch, message.wants_answer) == (2, False)
    assert not exchange.receive_header(MediaHeader(1, 1, 3)), "sent before the new epoch was heard"
    assert exchange.receive_header(MediaHeader(1, 2, 0))
    assert not exchange.receive_header(MediaHeader(1, 2, 5))
    assert exchange.announce({5: 2}, 3, {"1-a"}, 3, 1.0 + EPOCH_INTERVAL_S / 2) == []
    assert len(exchange.announce({5: 2}, 3, {"1-a"}, 3, 1.0 + EPOCH_INTERVAL_S)) == 1


def test_a_hole_from_one_node_does_not_stop_the_numbers_of_another_in_the_new_epoch() -> None:
    exchange = Exchange(ROOM, "3-c", 1)
    exchange.announce({5: 2}, 3, {"1-a", "2-b"}, 2, 0.0)
    assert exchange.receive_header(MediaHeader(1, 1, 0))
    assert exchange.receive_header(MediaHeader(2, 1, 0))
    assert not exchange.receive_header(MediaHeader(1, 1, 2))
    exchange.announce({5: 2}, 3, {"1-a", "2-b"}, 2, 1.0)
    assert exchange.receive_header(MediaHeader(1, 2, 0))
    assert exchange.receive_header(MediaHeader(2, 2, 0))


def test_wishes_are_told_when_they_change_to_who_is_new_and_now_and_then() -> None:
    exchange = Exchange(ROOM, "1-a", 1)
    assert len(exchange.announce({}, 3, {"2-b"}, 2, 0.0)) == 1
    assert exchange.announce({}, 3, {"2-b"}, 2, 0.1) == []
    assert [node for node, _ in exchange.announce({5: 1}, 3, {"2-b"}, 2, 0.2)] == ["2-b"]
    told = exchange.announce({5: 1}, 3, {"2-b", "3-c"}, 2, 0.3)
    assert [(node, message.wants_answer) for node, message in told] == [("3-c", True)]
    assert not exchange.is_due(0.2 + ANNOUNCE_S / 2)
    assert exchange.is_due(0.2 + ANNOUNCE_S)
    assert len(exchange.announce({5: 1}, 3, {"2-b", "3-c"}, 2, 0.2 + ANNOUNCE_S)) == 2


def test_who_asks_gets_an_answer_once_and_older_wishes_are_ignored() -> None:
    exchange = Exchange(ROOM, "1-a", 1)
    exchange.announce({}, 3, {"2-b"}, 2, 0.0)
    newer = Interest(ROOM, "2-b", 9, 4, 3, True)
    assert exchange.receive_interest(newer)
    assert len(exchange.announce({}, 3, {"2-b"}, 2, 0.1)) == 1
    assert exchange.announce({}, 3, {"2-b"}, 2, 0.2) == []
    assert not exchange.receive_interest(Interest(ROOM, "2-b", 8, 4, 3, False))
    assert not exchange.receive_interest(newer)
    assert exchange.receive_interest(Interest(ROOM, "2-b", 1, 5, 3, False))


layers = st.dictionaries(st.integers(0, MAX_STREAM), st.integers(0, 7), max_size=20)
messages = st.one_of(
    st.builds(
        Interest,
        room=st.just(ROOM),
        node=st.just("3-abc"),
        number=st.integers(0, 2**40),
        epoch=st.integers(0, 2**32 - 1),
        revision=st.integers(0, 2**62),
        wants_answer=st.booleans(),
        layers=layers,
    ),
    st.builds(Ask, room=st.just(ROOM), stream=st.integers(0, MAX_STREAM), why=st.just("asked")),
    st.builds(
        Passed,
        room=st.just(ROOM),
        sender=st.just("x-1"),
        whisper=st.builds(Whisper, peer_id=st.just("y-2"), data=st.binary(max_size=512)),
    ),
)


@given(messages)
def test_what_a_node_says_is_what_another_hears(message: Interest | Ask | Passed) -> None:
    assert decode_node_message(encode_node_message(message)) == message


@given(st.data())
def test_any_bytes_are_a_message_of_a_node_or_refused_without_being_quoted(
    data: st.DataObject,
) -> None:
    good = encode_node_message(data.draw(messages))
    record = encode_record(Record((Member("1-a", somebody("ada")),), {"p": "left"}, "1-a"))
    base = bytearray(data.draw(st.sampled_from([good, record]) | st.binary(max_size=64)))
    for _ in range(data.draw(st.integers(0, 3))):
        if base:
            base[data.draw(st.integers(0, len(base) - 1))] = data.draw(st.integers(0, 255))
    refusals = []
    for decode in (decode_node_message, decode_record, decode_media_header):
        try:
            decode(bytes(base))
        except ClusterMessageError as error:
            refusals.append(str(error))
    assert "ada" not in " ".join(refusals)


def somebody(name: str) -> Peer:
    return Peer(peer_id="p1", name=name, tracks=(Track(kind="face", stream=9),), identity=name)


def test_a_record_keeps_who_is_where_in_order_and_no_record_is_an_empty_room() -> None:
    record = Record(
        (Member("1-a", somebody("ada"), muted=(9,)), Member("2-b", somebody("bob"))),
        {"p3": "left"},
        "2-b",
    )
    assert decode_record(encode_record(record)) == record
    assert decode_record(b"") == Record()


def test_the_largest_room_of_the_largest_peers_fits_into_a_record_eight_times() -> None:
    tracks = tuple(
        Track(kind="f" * 16, avatar="a" * 64, stream=60_000 + i, profile="b" * 64) for i in range(4)
    )
    peer = Peer(peer_id="p" * 64, name="n" * 64, tracks=tracks, identity="i" * 64)
    record = Record((Member("127-0123abcd", peer),) * 64, {}, "1-a")
    assert len(encode_record(record)) * 8 < 1_000_000


@pytest.mark.parametrize("name", ["", "1", "-a", "128-a", "x-a", "1-", "1-a.b", "1->"])
def test_what_is_no_name_of_a_node_never_becomes_part_of_a_subject(name: str) -> None:
    with pytest.raises(ClusterMessageError):
        slot_of(name)


@pytest.mark.parametrize("size", [0, MEDIA_HEADER_BYTES, 20_000])
def test_media_of_a_wrong_size_is_refused(size: int) -> None:
    with pytest.raises(ClusterMessageError):
        decode_media_header(bytes([1]) * size)
    assert decode_media_header(encode_media(MediaHeader(3, 4, 5), b"\2x")) == MediaHeader(3, 4, 5)


def test_no_name_of_a_room_stands_in_what_represents_it() -> None:
    assert room_key("lobby") != room_key("lobby2")
    assert "lobby" not in room_key("lobby")
