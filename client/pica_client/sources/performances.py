"""Performances that ship with the package: generated faces with the statistics of real ones.

    talk             a person tells a story: phrases, pauses, stress with brows and head
    listen           a person follows it: nods, smiles, a short answer now and then
    range_of_motion  every muscle once, as actors do before a capture

No person was recorded for these; results on them are not results on people. What they share with
seven real Live Link Face takes is checked by `tests/client/sources/test_performances.py`: few
principal components (talk: 95 % of the variance in 5 or 6), a mean step of 0.001 to 0.006 a frame
with jumps at blinks, values in [0, 1], and mouthClose never more than 0.07 above jawOpen (it is a
corrective: alone it is nonsense).

``performances.npz`` holds a minute of several players each, as differences along the time in steps
of `STEP`; their generator is this module as of commit 75a96e61.
"""

from functools import cache
from importlib.resources import files

import numpy as np

from pica_client.errors import SourceError
from pica_client.sources.source import Recording
from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.types import FloatArray

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
