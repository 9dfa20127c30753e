"""What every source of expressions is: a face as a function of time.

A source knows no clock and never waits: the sender asks it for the face at a moment of the
*source's* time (seconds since the source began) and does the pacing itself. So the same source
serves a 30 fps call, a 90 Hz one, a test on a virtual clock and a statistics check.

Performances ship with the package, generated faces with the statistics of real ones:

    talk             a person tells a story: phrases, pauses, stress with brows and head
    listen           a person follows it: nods, smiles, a short answer now and then
    range_of_motion  every muscle once, as actors do before a capture

No person was recorded for these; results on them are not results on people. What they share with
seven real Live Link Face takes is checked by `tests/client/sources/test_sources.py`: few
principal components (talk: 95 % of the variance in 5 or 6), a mean step of 0.001 to 0.006 a frame
with jumps at blinks, values in [0, 1], and mouthClose never more than 0.07 above jawOpen (it is a
corrective: alone it is nonsense).

``performances.npz`` holds a minute of several players each, as differences along the time in steps
of `STEP`; their generator is `performances.py` as of commit 75a96e61.
"""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Protocol

import numpy as np

from pica_client.errors import SourceError
from pica_core.avatar.arkit import NUM_ARKIT, ExpressionFrame
from pica_core.types import BoolArray, Float64Array, FloatArray


class Source(Protocol):
    """A face as a function of time."""

    def frame_at(self, time_s: float) -> ExpressionFrame:
        """The face at a moment of the source's time, interpolated between its samples.

        Args:
            time_s: Seconds since the source began; any finite number (recordings loop in both
                directions).

        Returns:
            The face; its `captured_us` is when it looked so in the source's time, for which the
            sender puts its own clock. A tracker's lies a little before `time_s`.
        """
        ...


class Unseen:
    """A source without a tracker: there is never a face, and the voice alone makes one."""

    def frame_at(self, time_s: float) -> ExpressionFrame:
        """No face; see `Source.frame_at`."""
        return ExpressionFrame(
            captured_us=round(time_s * 1e6), arkit=np.zeros(NUM_ARKIT, np.float32), has_face=False
        )


class Present(Unseen):
    """One whose face is there even while its voice is silent."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Recording:
    """Samples of a face that loop for ever: the common end of files and of generated performances.

    Between two samples values are interpolated linearly; rotation vectors too, which for the small
    angle between two neighbouring samples differs from a slerp by less than the tracker's noise.
    The last sample runs into the first one within `loop_gap_s`.

    Attributes:
        times_s: Strictly rising times of the samples, one or more, from 0 on. float64 ``[T]``.
        arkit: Values in `ARKIT_NAMES` order. float32 ``[T, 52]``.
        rotation: Head rotation vectors, radians, head to seat. float32 ``[T, 3]``.
        translation_m: Head offsets from the seat in metres. float32 ``[T, 3]``.
        has_face: True where the tracker saw a face. bool ``[T]``.
        loop_gap_s: From the last sample to the repeated first one.
        start_s: Where in the recording the source's time 0 lies.
    """

    times_s: Float64Array
    arkit: FloatArray
    rotation: FloatArray
    translation_m: FloatArray
    has_face: BoolArray
    loop_gap_s: float
    start_s: float = 0.0

    @property
    def duration_s(self) -> float:
        """Length of one turn of the loop."""
        return float(self.times_s[-1]) + self.loop_gap_s

    def frame_at(self, time_s: float) -> ExpressionFrame:
        """Return the face at a time; see `Source.frame_at`."""
        looped_s = (time_s + self.start_s) % self.duration_s
        after = int(np.searchsorted(self.times_s, looped_s, side="right"))
        before = after - 1
        begin_s = float(self.times_s[before])
        if after == len(self.times_s):
            after, span_s = 0, self.loop_gap_s
        else:
            span_s = float(self.times_s[after]) - begin_s
        if not (self.has_face[before] and self.has_face[after]):
            after = before  # there is nothing between a face and no face
        weight = np.float32(min((looped_s - begin_s) / span_s, 1.0))

        def blend(values: FloatArray) -> FloatArray:
            mixed: FloatArray = values[before] + weight * (values[after] - values[before])
            return mixed

        return ExpressionFrame(
            captured_us=round(time_s * 1e6),
            arkit=blend(self.arkit),
            rotation=blend(self.rotation),
            translation_m=blend(self.translation_m),
            has_face=bool(self.has_face[before]),
        )


PERFORMANCES = ("talk", "listen", "range_of_motion")
SAMPLE_FPS = 60.0
"""Samples a second (chosen: twice the usual stream, so that a blink keeps its shape)."""
STEP = 2.0**-15
"""What one unit of the file is: of a shape's value, of radians."""
STEP_M = STEP / 4
"""What it is of the head's offset."""
LATER_S = 23.7
"""How much later the players begin for seeds beyond their number (chosen: none is in phase)."""


@cache
def _players(name: str) -> FloatArray:
    """Values, rotation vector and offset of each player of a performance, ``[N, T, 58]``."""
    with np.load(str(files("pica_client.sources") / "performances.npz")) as stored:
        values = np.cumsum(stored[name], axis=2, dtype=np.int32).transpose(0, 2, 1) * STEP
    values[..., NUM_ARKIT + 3 :] *= STEP_M / STEP
    return values.astype(np.float32)


def make_performance(name: str, *, seed: int = 0, start_s: float = 0.0) -> Recording:
    """Make a source of a performance.

    Args:
        name: One of `PERFORMANCES`.
        seed: Chooses the player: same manner, other words. 0 to 2³²−1; the few that there are
            repeat, begun elsewhere.
        start_s: Where in the performance the source begins, seconds.

    Returns:
        A looping recording at 60 samples a second.

    Raises:
        SourceError: Unknown name or seed out of range.
    """
    if name not in PERFORMANCES:
        raise SourceError(f"performance {name!r} is unknown; known are {', '.join(PERFORMANCES)}")
    if not 0 <= seed < 2**32:
        raise SourceError(f"performance seed is {seed}; allowed are 0 to 4294967295")
    players = _players(name)
    turn, player = divmod(seed, len(players))
    values = players[player]
    return Recording(
        times_s=np.arange(len(values)) / SAMPLE_FPS,
        arkit=values[:, :NUM_ARKIT],
        rotation=values[:, NUM_ARKIT : NUM_ARKIT + 3],
        translation_m=values[:, NUM_ARKIT + 3 :],
        has_face=np.ones(len(values), np.bool_),
        loop_gap_s=1 / SAMPLE_FPS,
        start_s=start_s + turn * LATER_S,
    )
