"""What a silent room sounds like: noise with the spectrum of the last quiet moments. Pure.

Where nothing is sent because nobody speaks, a dead line sounds as if the call had ended.
"""

import numpy as np

from pica_core.types import Array

SIZE = 960
"""Samples of a piece: 20 ms. Pieces overlap by half."""
MEMORY = 0.8
"""Share of the spectrum that stays with each quiet frame."""
LOUDEST = 0.01
"""Root mean square above which no noise is made: -40 dB of full scale (chosen: a room louder than
that is no silence)."""


class ComfortNoise:
    """Noise like that of the quiet frames of one voice."""

    def __init__(self, seed: int = 0) -> None:
        self._rng = np.random.default_rng(seed)
        self._window = np.sqrt(np.hanning(SIZE + 1)[:SIZE])
        self._powers = np.zeros(SIZE // 2 + 1)
        self._tail = np.zeros(SIZE // 2)

    def learn(self, quiet: Array) -> None:
        """Take a frame of `SIZE` samples in which nobody speaks."""
        powers = np.abs(np.fft.rfft(quiet * self._window)) ** 2
        self._powers = MEMORY * self._powers + (1 - MEMORY) * powers

    def make(self) -> Array:
        """The next `SIZE` samples, float64."""
        pieces = []
        for _ in range(2):
            phases = np.exp(2j * np.pi * self._rng.random(len(self._powers)))
            # A window of half its power, each sample in two of them.
            piece = np.fft.irfft(np.sqrt(2 * self._powers) * phases, SIZE) * self._window
            pieces.append(piece[: SIZE // 2] + self._tail)
            self._tail = piece[SIZE // 2 :]
        noise = np.concatenate(pieces)
        rms = float(np.sqrt(np.mean(noise**2)))
        return noise * min(1.0, LOUDEST / rms) if rms > 0 else noise
