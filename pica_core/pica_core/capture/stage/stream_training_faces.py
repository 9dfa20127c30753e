"""Performances to learn a latent stream from: what a sender may be given, before anybody sends.

The stage's own generators, at 30 frames a second, in several tempos and strengths: a stream's
probability tables adapt to how lively a face is, so they must have seen every liveliness. No
performance of the client and no recording is among them; those are for testing.
"""

from collections.abc import Callable

import numpy as np

from pica_core.capture.stage.expressions import (
    combinations,
    lids_and_gaze,
    range_of_motion,
    sentence,
)
from pica_core.types import FloatArray

TEMPOS = (1, 2, 4)
"""Times as slow. The generators are livelier than seven real takes were."""
FRAMES = 120
"""Length of each before its tempo, at 30 frames a second."""
STRENGTHS = (1.0, 0.7)
KINDS: tuple[tuple[Callable[[np.random.Generator, int], FloatArray], int], ...] = (
    (sentence, 1),
    (range_of_motion, 1),
    (combinations, 1),
    (lids_and_gaze, 3),
)
"""Each with how rarely it comes: eyes alone every third round."""


def stream_training_performances(rounds: int = 36, seed: int = 0) -> list[FloatArray]:
    """Generate `rounds` performances of each kind: ARKit values, float32 ``[T, 52]`` each."""
    performances = []
    for number in range(rounds):
        for kind, (make, rarity) in enumerate(KINDS):
            if number % rarity:
                continue
            values = make(np.random.default_rng([seed, number, kind]), FRAMES)
            slowed = _slow_down(values, TEMPOS[number % len(TEMPOS)])
            performances.append(slowed * np.float32(STRENGTHS[number % len(STRENGTHS)]))
    return performances


def _slow_down(values: FloatArray, times: int) -> FloatArray:
    """The same performance, so many times as slow."""
    moments = np.linspace(0, len(values) - 1, len(values) * times)
    before = np.minimum(moments.astype(np.int64), len(values) - 2)
    share = (moments - before)[:, None]
    return (values[before] * (1 - share) + values[before + 1] * share).astype(np.float32)
