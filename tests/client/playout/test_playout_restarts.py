"""Senders whose clock jumps, and who begin again, as the playout buffer's callers see them."""

import pytest

from helpers.playout_trial import (
    FRAME_S,
    WAY_S,
    arrivals,
    between,
    face,
    play,
    steps,
    value_at,
    value_of,
)
from pica_client.playout.buffer import CEILING_S, Playout, Timeline
from pica_client.playout.sender_clock import RESTART_FRAMES, DecodedFrame, SenderClock
from pica_protocol.frames import Frame

pytestmark = pytest.mark.unit


def test_frames_that_wait_go_when_an_older_one_comes_after_them() -> None:
    timeline = Timeline()
    old, late, new, newest = (DecodedFrame(0, face(0), at_s) for at_s in (0.0, 0.05, 0.1, 0.2))
    for frame in (old, new, newest, late):
        assert timeline.append(frame)
        timeline.release(0.0)
    assert timeline.following == late
    assert timeline.num_waiting == 1
    assert not timeline.append(old._replace(media_s=-1.0))


@pytest.mark.parametrize("fps", [5, 30])
@pytest.mark.parametrize("jump_s", [-3600.0, -0.3, 0.05, 5.0])
def test_a_sender_whose_clock_jumps_plays_on_with_the_usual_delay(jump_s: float, fps: int) -> None:
    playout = Playout()
    frames = [
        frame._replace(captured_us=frame.captured_us + round(jump_s * 1e6))
        if frame.captured_s >= 8
        else frame
        for frame in arrivals(seconds=18, fps=fps)
    ]
    ticks = play(playout, frames, seconds=18)
    assert max(steps(ticks)) <= 0.12
    report = playout.report()
    assert report.concealed <= 30
    delay_s = min(1 / fps, 0.2)
    assert report.delay_s == pytest.approx(delay_s, abs=0.002)
    for tick in between(ticks, 16, 18):
        assert tick.played is not None
        true = value_at(tick.now - WAY_S - delay_s)
        assert value_of(tick.played) == pytest.approx(true, abs=0.01 if fps == 30 else 0.2)


RESTARTS = {
    "sequence and clock": (0, -4_900_000_000),
    "sequence alone": (0, 0),
    "sequence elsewhere": (40_000, 0),
    "far ahead in the same sequence": (9_000, 77_000_000),
}


@pytest.mark.parametrize("name", RESTARTS)
@pytest.mark.parametrize("first_s", [0.1, 10.0])
def test_a_stream_that_begins_again_plays_on(name: str, first_s: float) -> None:
    sequence, clock_us = RESTARTS[name]
    playout = Playout()
    frames = []
    for frame in arrivals(seconds=20):
        if frame.captured_s < first_s:
            frames.append(frame)
        elif frame.captured_s >= first_s + 3:
            number = frame.number - round((first_s + 3) * 30) + sequence
            frames.append(frame._replace(number=number, captured_us=frame.captured_us + clock_us))
    ticks = play(playout, frames, seconds=20)
    report = playout.report()
    assert report.delay_s == pytest.approx(FRAME_S, abs=0.001)
    assert max(steps(ticks)) <= 0.07
    for tick in between(ticks, first_s + 3.5, 20):
        assert tick.played is not None
        assert not tick.played.is_concealed
        true = value_at(tick.now - WAY_S - FRAME_S)
        assert value_of(tick.played) == pytest.approx(true, abs=0.01)


BOGUS = {
    "from the far future": (0, 3_600_000_000),
    "from the far past": (0, -3_600_000_000),
    "from the near future": (0, 400_000),
    "of another sequence": (30_000, 0),
    "of a sequence long ago": (-2_000, 0),
}


@pytest.mark.parametrize("name", BOGUS)
def test_one_bad_frame_spoils_neither_buffer_nor_estimate(name: str) -> None:
    sequence, clock_us = BOGUS[name]
    playout = Playout()
    frames = [
        frame._replace(number=frame.number + sequence, captured_us=frame.captured_us + clock_us)
        if frame.number == 300
        else frame
        for frame in arrivals(seconds=18)
    ]
    ticks = play(playout, frames, seconds=18)
    report = playout.report()
    assert max(steps(ticks)) <= 0.07
    for tick in between(ticks, 10.5, 18):  # half a second later
        assert tick.played is not None
        true = value_at(tick.now - WAY_S - FRAME_S)
        assert value_of(tick.played) == pytest.approx(true, abs=0.01)
    assert report.delay_s == pytest.approx(FRAME_S, abs=0.001)
    assert report.concealed <= 10


def test_numbers_go_on_across_the_wrap_and_leap_where_the_sender_begins_again() -> None:
    clock = SenderClock()

    def number(sequence: int, captured_s: float, now: float) -> int:
        captured_us = round(captured_s * 1e6)
        frame = Frame(stream=1, sequence=sequence, captured_us=captured_us, payload=b"")
        received = clock.receive(frame, now)
        assert received is not None
        return received.number

    numbers = [number(n % 65536, n / 30, n / 30) for n in range(65_534, 65_540)]
    assert numbers == list(range(65_534, 65_540))
    again = [number(n, 77 + n / 30, 3000 + n / 30) for n in range(3)]
    assert again == [again[0], again[0] + 1, again[0] + 2]
    assert again[0] > 65_539 + RESTART_FRAMES


def test_a_stream_that_begins_in_a_stall_is_no_later_than_any_other_after_it() -> None:
    playout = Playout()
    frames = [frame._replace(arrived_s=max(frame.arrived_s, 1.5)) for frame in arrivals(seconds=12)]
    ticks = play(playout, frames, seconds=12)
    ages_s = [tick.report.age_s for tick in between(ticks, 2.5, 12)]
    assert max(ages_s) <= CEILING_S + 0.001
    assert ages_s[-1] == pytest.approx(FRAME_S, abs=0.001)
