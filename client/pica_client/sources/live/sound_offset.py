"""How much later a tracker sees a mouth than a microphone hears it, from plosives ("pa"). Pure.

The lips of a plosive part at the moment that is heard: its burst begins there. A camera, a phone
and the way from it take their time, which nobody tells us; it is the same with every plosive.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from pica_client.errors import SourceError
from pica_core.types import Float64Array, FloatArray

STEP_S: Final = 0.002
"""Sound is looked at in pieces of this length."""
QUIET_S: Final = 0.25
"""How long it must have been quiet before a plosive."""
BURST_RATIO: Final = 10.0
"""Root mean square of a burst, over that of the quiet before it (chosen: 20 dB)."""
BURST_RMS: Final = 0.003
"""Least root mean square of a burst: -50 dB of full scale."""
EARLY_S, LATE_S = 0.15, 0.5
"""How long before and after its burst a mouth may be seen to open."""
LEAST_RISE: Final = 0.1
"""Least opening of a mouth that is one."""
NUM_AGREEING: Final = 3
"""Plosives that must be clear."""
AGREEING_S: Final = 0.03
"""How near to their median."""


def sound_offset(
    opening: Sequence[tuple[float, float]], sound: FloatArray, sound_begin_s: float, rate_hz: float
) -> tuple[float, int]:
    """Measure how much later mouths are seen than heard.

    Args:
        opening: When a face was seen on our clock, seconds, rising, and how far its mouth is open,
            0 to 1.
        sound: What the microphone heard. float32 ``[N]``.
        sound_begin_s: When its first sample was captured, on the same clock.
        rate_hz: Samples of it a second.

    Returns:
        The offset in seconds, the median of those that agree, and how many these are.

    Raises:
        SourceError: Too few plosives were heard and seen; says how to do better.
    """
    times_s, openings = np.array(opening, np.float64).reshape(-1, 2).T
    found = [
        seen_s - heard_s
        for heard_s in _bursts(sound, rate_hz) + sound_begin_s
        if (seen_s := _opens(times_s, openings, heard_s)) is not None
    ]
    middle_s = float(np.median(found)) if found else 0.0
    agreeing = [each for each in found if abs(each - middle_s) <= AGREEING_S]
    if len(agreeing) < NUM_AGREEING:
        raise SourceError(
            f"{len(agreeing)} of {len(found)} openings of the mouth fit to a sound, "
            f'{NUM_AGREEING} are needed; say "pa", close your lips, wait a second, and again'
        )
    return float(np.median(agreeing)), len(agreeing)


def _bursts(sound: FloatArray, rate_hz: float) -> Float64Array:
    """When it becomes loud after a silence, seconds from the sound's beginning."""
    size, quiet = round(STEP_S * rate_hz), round(QUIET_S / STEP_S)
    steps = sound[: len(sound) // size * size].reshape(-1, size)
    rms = np.sqrt(np.mean(np.square(steps, dtype=np.float64), axis=1))
    begins, at = [], quiet
    while at < len(rms):
        # Clicks of one piece are no room noise.
        floor = float(np.quantile(rms[at - quiet : at], 0.9))
        if rms[at] > max(BURST_RATIO * floor, BURST_RMS):
            begins.append(at * STEP_S)
            at += quiet
        at += 1
    return np.array(begins, np.float64)


def _opens(times_s: Float64Array, openings: Float64Array, heard_s: float) -> float | None:
    """When the mouth that was heard then is seen to begin to open; None where it does not."""
    near = (times_s >= heard_s - EARLY_S) & (times_s <= heard_s + LATE_S)
    times, values = times_s[near], openings[near]
    if len(times) < 4:
        return None
    top = int(np.argmax(values))
    shut = top - int(np.argmin(values[top::-1]))
    rise = values[top] - values[shut]
    if rise < LEAST_RISE:
        return None
    # Where the line through a fifth and a half of the rise meets the closed mouth.
    fifth_s, half_s = (
        float(np.interp(values[shut] + share * rise, values[shut : top + 1], times[shut : top + 1]))
        for share in (0.2, 0.5)
    )
    return fifth_s - (half_s - fifth_s) * 0.2 / 0.3
