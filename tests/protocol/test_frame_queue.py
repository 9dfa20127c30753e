from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_protocol.frame_queue import LATEST_BYTES, MAX_WAITING, FrameQueue, QueuedFrame

pytestmark = pytest.mark.unit

DEADLINE_S = 0.2
PACKET_BYTES, FACE_BYTES = 120, 60


def voice(sender: str, index: int = 0, now: float = 0.0, size: int = PACKET_BYTES) -> QueuedFrame:
    return QueuedFrame(sender, 1, bytes([index]) * size, now, DEADLINE_S)


def face(sender: str, index: int = 0, stream: int = 2, size: int = FACE_BYTES) -> QueuedFrame:
    return QueuedFrame(sender, stream, bytes([index]) * size, 0.0, None)


def test_the_newest_face_of_a_stream_waits_and_the_last_packets_of_a_voice() -> None:
    drops: Counter[str] = Counter()
    queue = FrameQueue(drops)
    for index in range(30):
        queue.put(face("ada", index))
        queue.put(voice("ada", index))
    taken = queue.take(1 << 30, now=0.0)
    assert [frame.data[0] for frame in taken] == [*range(30 - MAX_WAITING, 30), 29]
    assert drops == {"replaced": 29, "overflow": 30 - MAX_WAITING}
    assert len(queue) == 0


def test_a_packet_past_its_deadline_is_dropped() -> None:
    drops: Counter[str] = Counter()
    queue = FrameQueue(drops)
    queue.put(voice("ada", 0, now=1.0))
    queue.put(voice("ada", 1, now=1.15))
    assert [frame.data[0] for frame in queue.take(1200, now=1.3)] == [1]
    assert drops == {"expired": 1}


def test_one_sender_that_sends_too_much_leaves_the_others_their_share() -> None:
    queue = FrameQueue(Counter())
    num_heard: Counter[str] = Counter()
    for step in range(100):
        for _ in range(3):
            queue.put(voice("hog", size=1000))
        for name in ("ada", "bob", "cyd"):
            queue.put(voice(name, step))
            queue.put(face(name, step))
        for frame in queue.take(1200, now=0.0):
            num_heard[frame.sender + ("" if frame.deadline_s is None else " speaks")] += 1
    for name in ("ada", "bob", "cyd"):
        assert num_heard[f"{name} speaks"] >= 95
        assert num_heard[name] >= 60
    assert num_heard["hog speaks"] <= 100


def test_faces_beside_a_voice_take_turns() -> None:
    queue = FrameQueue(Counter())
    num_shown: Counter[str] = Counter()
    for _ in range(60):
        queue.put(voice("ada"))
        for name in "bcdefg":
            queue.put(face(name))
        num_shown.update(f.sender for f in queue.take(1200, now=0.0) if f.deadline_s is None)
    assert 60 * LATEST_BYTES // FACE_BYTES - 6 <= num_shown.total() <= 60 * 3
    assert 2 * min(num_shown.values()) >= max(num_shown.values())


def test_a_face_larger_than_its_room_saves_up_for_its_turn() -> None:
    queue = FrameQueue(Counter())
    sizes = []
    for _ in range(10):
        queue.put(voice("ada"))
        queue.put(face("bob", size=400))
        sizes += [len(f.data) for f in queue.take(1200, now=0.0) if f.deadline_s is None]
    assert 3 <= len(sizes) < 10


frames = st.tuples(
    st.sampled_from("abc"),
    st.integers(1, 3),
    st.booleans(),
    st.integers(1, 1200),
    st.integers(0, 9),
)


@given(st.lists(st.one_of(frames, st.integers(1, 3000)), max_size=80))
def test_nothing_is_lost_count_of_and_no_more_is_taken_than_fits(
    steps: list[tuple[str, int, bool, int, int] | int],
) -> None:
    drops: Counter[str] = Counter()
    queue = FrameQueue(drops)
    given_frames = taken_frames = 0
    for step in steps:
        if isinstance(step, int):
            taken = queue.take(step, now=0.0)
            taken_frames += len(taken)
            assert len(taken) <= 1 or sum(len(frame.data) for frame in taken) <= step
            assert taken or not len(queue)
        else:
            sender, stream, is_ordered, size, drop = step
            stream += 10 * "abc".index(sender)
            deadline_s = DEADLINE_S if is_ordered else None
            stream += 100 * is_ordered
            queue.put(QueuedFrame(sender, stream, bytes(size), 0.0, deadline_s))
            given_frames += 1
            if drop == 0:
                drops["stream"] += queue.drop(sender, stream)
        assert len(queue) <= 9 * (MAX_WAITING + 1)
    assert given_frames == taken_frames + drops.total() + len(queue)
