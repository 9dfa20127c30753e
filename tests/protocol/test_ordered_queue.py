"""Frames of ordered streams: all of them in order, none too late."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_protocol.messages import Track
from pica_protocol.ordered_queue import (
    MAX_WAITING_BYTES,
    MAX_WAITING_FRAMES,
    OrderedQueue,
    queue_for,
)
from pica_protocol.stream_queue import Put, StreamQueue

pytestmark = pytest.mark.unit


def queue_of(*frames: bytes, deadline_s: float = 0.2) -> tuple[OrderedQueue, Counter[str]]:
    drops: Counter[str] = Counter()
    queue = OrderedQueue(drops, deadline_s)
    for frame in frames:
        assert queue.put(frame, layer=0, is_keyframe=False, now=0.0) is Put.WAITS
    return queue, drops


def taken(queue: OrderedQueue, max_bytes: int = 100_000) -> list[bytes]:
    return [item.frame for item in queue.take(max_bytes)]


def test_frames_come_out_in_order_without_any_keyframe() -> None:
    queue, drops = queue_of(b"a", b"b", b"c")
    assert taken(queue) == [b"a", b"b", b"c"]
    assert taken(queue) == []
    assert drops == {}


def test_no_more_is_taken_than_fits_and_the_rest_stays_in_order() -> None:
    queue, _ = queue_of(b"aaa", b"bbb", b"c")
    assert taken(queue, max_bytes=5) == [b"aaa"]
    assert (len(queue), queue.num_bytes) == (2, 4)
    assert taken(queue) == [b"bbb", b"c"]


def test_a_frame_is_dropped_once_it_has_waited_longer_than_the_deadline() -> None:
    queue, drops = queue_of(b"a", deadline_s=0.2)
    queue.put(b"b", 0, False, now=0.1)
    queue.expire(now=0.2)
    assert len(queue) == 2
    queue.expire(now=0.25)
    assert taken(queue) == [b"b"]
    assert drops == {"expired": 1}


def test_a_stream_that_goes_on_while_nobody_reads_keeps_what_is_not_too_old() -> None:
    queue, drops = queue_of(deadline_s=0.2)
    for i in range(100):
        queue.put(bytes([i]), 0, False, now=i * 0.02)
    assert taken(queue) == [bytes([i]) for i in range(89, 100)]
    assert drops == {"expired": 89}


@pytest.mark.parametrize("num_bytes", [1, 1200])
def test_too_many_frames_or_bytes_drop_the_oldest(num_bytes: int) -> None:
    queue, drops = queue_of(deadline_s=10.0)
    for i in range(1000):
        queue.put(i.to_bytes(2, "big") * (num_bytes // 2 or 1), 0, False, now=0.0)
        assert len(queue) <= MAX_WAITING_FRAMES
        assert queue.num_bytes <= MAX_WAITING_BYTES
    last = taken(queue)[-1]
    assert last[:2] == (999).to_bytes(2, "big")
    assert drops["overflow"] > 700


def test_who_wants_none_gets_none_and_then_what_comes_next() -> None:
    queue, _ = queue_of(b"a", b"b")
    assert queue.want(None) == 2
    assert queue.put(b"c", 0, False, now=0.0) is Put.DROPPED
    assert queue.want(7) == 0
    queue.put(b"d", 0, False, now=0.0)
    assert taken(queue) == [b"d"]


def test_the_policy_of_a_track_decides_its_queue() -> None:
    ordered = queue_for(Track(kind="voice", policy="ordered", deadline_ms=300), Counter())
    assert isinstance(ordered, OrderedQueue)
    assert isinstance(queue_for(Track(kind="face"), Counter()), StreamQueue)


@given(
    steps=st.lists(
        st.one_of(
            st.tuples(st.just("put"), st.integers(1, 1200)),
            st.tuples(st.just("take"), st.integers(0, 5000)),
            st.tuples(st.just("wait"), st.floats(0, 0.3)),
        ),
        max_size=60,
    )
)
def test_whatever_happens_frames_come_in_order_in_time_and_are_counted(
    steps: list[tuple[str, float]],
) -> None:
    queue, drops = queue_of(deadline_s=0.2)
    now, num_put, seen = 0.0, 0, []
    for what, amount in steps:
        if what == "put":
            queue.put(num_put.to_bytes(2, "big") + bytes(int(amount)), 0, False, now)
            num_put += 1
        elif what == "wait":
            now += amount
        else:
            queue.expire(now)
            items = queue.take(int(amount))
            assert all(now - item.received_s <= 0.2 for item in items)
            assert sum(len(item.frame) for item in items) <= amount
            seen += [int.from_bytes(item.frame[:2], "big") for item in items]
    assert seen == sorted(set(seen))
    assert len(seen) + len(queue) + drops.total() == num_put
