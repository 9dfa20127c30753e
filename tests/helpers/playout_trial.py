"""A stream with seeded troubles as a playout buffer meets it: what comes when, what is shown.

Times in seconds on our clock; frame i is captured at i / fps, and the fastest way takes `WAY_S`.
The sender's clock is far ahead of ours: nothing may depend on the difference.

Unrealistic: the display never misses a refresh, and code takes no time.
"""

import math
import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pica_client.playout.buffer import PlayedFace, Playout, PlayoutReport
from pica_core.codec.latent_stream import LatentSample
from pica_protocol.frames import Frame

WAY_S = 0.04
FAR_CLOCK_US = 5_000_000_000
DISPLAY_HZ = 90
FRAME_S = 1 / 30
TICK_S = 2e-6
"""Capture times are whole microseconds: no test asks for more."""


class Arrival(NamedTuple):
    arrived_s: float
    number: int
    captured_us: int
    captured_s: float
    """On our clock."""


@dataclass(frozen=True, kw_only=True)
class Trouble:
    """What the way is like from the sixth second to the thirteenth; calm before and after."""

    jitter_s: float = 0.0
    """Up to this much is added to each frame's way, uniformly."""
    stalls: tuple[tuple[float, float], ...] = ()
    """Begin and length: nothing arrives, then all of it at once."""
    dropped_ratio: float = 0.0
    begin_s: float = 6.0
    end_s: float = 13.0


def value_at(captured_s: float) -> float:
    """A face that moves: by at most 4.7 a second."""
    return 0.5 * math.sin(2 * math.pi * 1.3 * captured_s) + 0.3 * math.sin(2 * captured_s)


def face(value: float, *, yaw: float = 0.0, is_still: bool = False) -> LatentSample:
    return LatentSample(
        latent=np.full((8, 8, 4), value, np.float32),
        rotation=np.array([0, yaw, 0], np.float32),
        translation_m=np.array([value / 10, 0, 0], np.float32),
        is_still=is_still,
    )


def value_of(played: PlayedFace) -> float:
    return float(played.sample.latent[0, 0, 0])


def arrivals(
    trouble: Trouble | None = None,
    *,
    seconds: float = 22.0,
    fps: float = 30.0,
    drift_ppm: float = 0.0,
) -> list[Arrival]:
    """What arrives, in the order of arrival."""
    trouble = trouble or Trouble()
    rng = random.Random(1)
    result: list[Arrival] = []
    last_s = 0.0
    for number in range(int(seconds * fps)):
        captured_s = number / fps
        arrived_s = captured_s + WAY_S
        if trouble.begin_s <= captured_s < trouble.end_s:
            arrived_s += rng.uniform(0, trouble.jitter_s)
            if rng.random() < trouble.dropped_ratio:
                continue
        for begin_s, length_s in trouble.stalls:
            if begin_s <= arrived_s < begin_s + length_s:
                arrived_s = begin_s + length_s
        arrived_s = last_s = max(arrived_s, last_s)
        captured_us = FAR_CLOCK_US + round(captured_s * (1 + drift_ppm * 1e-6) * 1e6)
        result.append(Arrival(arrived_s, number, captured_us, captured_s))
    return result


class Tick(NamedTuple):
    now: float
    played: PlayedFace | None
    report: PlayoutReport


def play(
    playout: Playout,
    frames: Iterable[Arrival],
    *,
    seconds: float = 22.0,
    display_hz: float = DISPLAY_HZ,
) -> list[Tick]:
    """Show a stream on a display."""
    waiting = list(frames)[::-1]
    ticks = []
    for index in range(int(seconds * display_hz)):
        now = (index + 0.37) / display_hz
        while waiting and waiting[-1].arrived_s <= now:
            frame = waiting.pop()
            sample = face(value_at(frame.captured_s), yaw=value_at(frame.captured_s) / 4)
            arrive(playout, frame.number, frame.captured_us, sample, frame.arrived_s)
        ticks.append(Tick(now, playout.sample_at(now), playout.report()))
    return ticks


def arrive(
    playout: Playout, number: int, captured_us: int, sample: LatentSample, now: float
) -> None:
    """Let a frame come off the wire."""
    frame = Frame(stream=1, sequence=number % 65536, captured_us=captured_us, payload=b"")
    playout.receive(frame, sample, now)


def steps(ticks: Sequence[Tick]) -> list[float]:
    """How far the face moved from each display time to the next."""
    values = [value_of(tick.played) for tick in ticks if tick.played is not None]
    return [abs(after - before) for before, after in pairwise(values)]


def between(ticks: Sequence[Tick], begin_s: float, end_s: float) -> list[Tick]:
    return [tick for tick in ticks if begin_s <= tick.now < end_s]


def concealed_ratio(ticks: Sequence[Tick]) -> float:
    shown = [tick.played for tick in ticks if tick.played is not None]
    return sum(played.is_concealed for played in shown) / len(shown)


def captured(index: float) -> int:
    return FAR_CLOCK_US + round(index * FRAME_S * 1e6)


def receive(
    playout: Playout, index: int, now: float, *, value: float | None = None, is_still: bool = False
) -> None:
    """Frame i is captured at our i / 30 s."""
    sample = face(float(index) if value is None else value, is_still=is_still)
    arrive(playout, index, captured(index), sample, now)


def shown(playout: Playout, now: float) -> PlayedFace:
    played = playout.sample_at(now)
    assert played is not None
    return played


def steady(playout: Playout, count: int) -> None:
    """`count` frames on a perfect network, on a display at 90 Hz."""
    for index in range(count):
        receive(playout, index, index * FRAME_S + 0.01)
        for third in range(3):
            playout.sample_at((index + third / 3) * FRAME_S + 0.01 + TICK_S)
