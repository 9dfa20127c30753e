"""A voice from where its person sits: each ear hears it when and as it would. Pure.

The farther ear hears later (Woodworth and Schlosberg, Experimental Psychology, 1962) and duller,
for the head is in the way of high tones. Nobody is softer for sitting far off.
"""

import math

import numpy as np

from pica_client.voice.packet import SAMPLE_RATE_HZ
from pica_client.voice.stretch import crossfade
from pica_core.types import Array

HEAD_RADIUS_M, SOUND_M_PER_S = 0.0875, 343.0
TAPS = 64
"""Taps of an ear's filter: 32 of the longest delay, and the tail of its low-pass."""
SHADOW_GAIN = 0.35
"""Share by which the far ear is softer at 90 degrees: 4 dB (chosen: tones below 1 kHz)."""
OPEN_HZ, SHADOW_HZ = 20_000.0, 3_000.0
"""Cut-off of the far ear in front and at 90 degrees (chosen)."""


def delay_s(azimuth_rad: float) -> float:
    """How much later the farther ear hears: at most 0.66 ms."""
    angle = min(abs(azimuth_rad), math.pi / 2)
    return HEAD_RADIUS_M / SOUND_M_PER_S * (angle + math.sin(angle))


def ear_taps(azimuth_rad: float) -> tuple[Array, Array]:
    """The filters of the left and the right ear, float64 ``[TAPS]`` each.

    Args:
        azimuth_rad: Where the voice comes from; positive is to the right.
    """
    side = abs(math.sin(azimuth_rad))
    times = np.arange(TAPS)
    near = np.zeros(TAPS)
    near[0] = 1.0
    late = delay_s(azimuth_rad) * SAMPLE_RATE_HZ
    whole, part = int(late), late - int(late)
    cutoff_hz = OPEN_HZ * (SHADOW_HZ / OPEN_HZ) ** side
    decay = math.exp(-2 * math.pi * cutoff_hz / SAMPLE_RATE_HZ)
    low_pass = decay**times
    low_pass *= (1 - SHADOW_GAIN * side) / low_pass.sum()
    far = np.zeros(TAPS)
    for shift, weight in ((whole, 1 - part), (whole + 1, part)):
        far[shift:] += weight * low_pass[: TAPS - shift]
    return (far, near) if azimuth_rad > 0 else (near, far)


class Placed:
    """One voice at its place; moves to another within a frame."""

    def __init__(self) -> None:
        self._azimuth_rad: float | None = None
        self._taps = np.zeros((2, TAPS))
        self._tail = np.zeros(TAPS - 1)

    def place(self, sound: Array, azimuth_rad: float) -> Array:
        """The sound for both ears, float64 ``[samples, 2]``."""
        whole = np.concatenate([self._tail, sound])
        self._tail = whole[-(TAPS - 1) :]
        before = self._taps
        if azimuth_rad != self._azimuth_rad:
            self._taps = np.stack(ear_taps(azimuth_rad))
            is_first, self._azimuth_rad = self._azimuth_rad is None, azimuth_rad
            if not is_first:
                return crossfade(_heard(whole, before), _heard(whole, self._taps)).T
        return _heard(whole, self._taps).T


def _heard(sound: Array, taps: Array) -> Array:
    return np.stack([np.convolve(sound, ear, "valid") for ear in taps])
