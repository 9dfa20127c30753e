"""The movements that performances are made of: one number over time, drawn from a generator.

What a `Player` draws is sampled at its `times_s`. The rhythms are those of people as textbooks give
them (blinks every 2 to 6 s of 150 to 300 ms; 4 to 5 syllables a second, in phrases with pauses;
gaze that jumps and rests); the exact distributions are our choice. Equal generators give equal
tracks.
"""

import numpy as np

from pica_core.types import Float64Array

SAMPLE_FPS = 60.0
"""Samples a second of every generated track (chosen: twice the usual stream, so that a blink keeps
its shape)."""
EDGE_S = 0.6
"""Nothing begins this near to either end, so that a loop closes without cutting a movement in
two."""


SPEECH_WIDTHS_S = {
    "jaw": 0.06,  # how far it is open: one bump a syllable
    "rounding": 0.08,  # lips forward and round, as in "oh"
    "spreading": 0.08,  # lips drawn apart, as in "ee"
    "closure": 0.04,  # lips pressed on each other, as in "m", "b", "p"
    "stress": 0.12,  # syllables that carry the weight of a phrase; brows and head go with it
}
"""What moves while somebody talks, and over how much each of these tracks is rounded off."""


def smooth(track: Float64Array, width_s: float) -> Float64Array:
    """Round a track off with a raised-cosine window of the given full width at half height."""
    half = max(round(width_s * SAMPLE_FPS), 1)
    window = np.hanning(2 * half + 1)
    padded = np.pad(track, half, mode="edge")
    smoothed: Float64Array = np.convolve(padded, window / window.sum(), mode="valid")
    return smoothed


def bump(
    times_s: Float64Array, begin_s: float, rise_s: float, hold_s: float, fall_s: float
) -> Float64Array:
    """Rise from 0 to 1 and fall back with smooth ends; exactly 0 before and after."""
    rising = np.clip((times_s - begin_s) / rise_s, 0, 1)
    falling = np.clip((begin_s + rise_s + hold_s + fall_s - times_s) / fall_s, 0, 1)
    shape = np.minimum(rising, falling)
    eased: Float64Array = shape * shape * (3 - 2 * shape)
    return eased


Range = tuple[float, float]
"""Least and most of what is drawn."""


class Player:
    """Draws one player's tracks from a generator, for some time."""

    def __init__(self, rng: np.random.Generator, duration_s: float) -> None:
        self.rng = rng
        self.times_s: Float64Array = np.arange(round(duration_s * SAMPLE_FPS)) / SAMPLE_FPS

    def blinks(self, every_s: Range = (2.0, 6.0)) -> Float64Array:
        """Lids that close and open: 150 to 300 ms in all, shutting faster than they open."""
        rng, times_s = self.rng, self.times_s
        track = np.zeros_like(times_s)
        begin_s = rng.uniform(EDGE_S, every_s[0])
        while begin_s < times_s[-1] - EDGE_S:
            duration_s = rng.uniform(0.17, 0.28)
            shut = bump(times_s, begin_s, 0.38 * duration_s, 0.1 * duration_s, 0.52 * duration_s)
            track = np.maximum(track, rng.uniform(0.9, 1.0) * shut)
            begin_s += rng.uniform(*every_s)
        return track

    def saccades(
        self, spread: float, rest_s: Range, away: float = 0.0
    ) -> tuple[Float64Array, Float64Array]:
        """Where the eyes look: (to the subject's left, up), ±`spread`; jumps of 50 ms, then rest.

        `away` is how often a jump leads away from whom they talk with, twice as far to a side.
        """
        rng, times_s = self.rng, self.times_s
        left, up = np.zeros_like(times_s), np.zeros_like(times_s)
        begin_s = EDGE_S
        while begin_s < times_s[-1] - EDGE_S:
            target_left, target_up = spread * rng.normal(size=2).clip(-2, 2) * (1.0, 0.6)
            if rng.random() < 0.4:  # people come back to whom they talk with
                target_left, target_up = 0.0, 0.0
            elif rng.random() < away:
                target_left *= 2.0
            after = times_s >= begin_s
            left[after], up[after] = target_left, target_up
            begin_s += rng.uniform(*rest_s)
        at_end = times_s >= times_s[-1] - EDGE_S
        left[at_end], up[at_end] = 0.0, 0.0
        return smooth(left, 0.04), smooth(up, 0.04)

    def drift(self, period_s: Range) -> Float64Array:
        """A slow wandering of about ±1 that closes on itself at the end of the track."""
        rng, times_s = self.rng, self.times_s
        duration_s = len(times_s) / SAMPLE_FPS
        track: Float64Array = np.zeros_like(times_s)
        weights = rng.uniform(0.5, 1.0, size=4)
        for weight in weights:
            turns = max(round(duration_s / rng.uniform(*period_s)), 1)
            phase = rng.uniform(0, 2 * np.pi)
            track += weight * np.sin(2 * np.pi * turns * times_s / duration_s + phase)
        track /= weights.sum()
        return track

    def nods(self, every_s: Range) -> Float64Array:
        """Nods of two or three swings at about 2 Hz; +1 is the chin at its lowest."""
        rng, times_s = self.rng, self.times_s
        track = np.zeros_like(times_s)
        begin_s = rng.uniform(EDGE_S, every_s[0])
        while begin_s < times_s[-1] - 2.0:
            swings, rate_hz = int(rng.integers(2, 4)), rng.uniform(1.7, 2.4)
            length_s = swings / rate_hz
            inside = (times_s >= begin_s) & (times_s < begin_s + length_s)
            phase = (times_s[inside] - begin_s) * rate_hz
            # Each swing is a little smaller than the one before.
            track[inside] = (0.5 - 0.5 * np.cos(2 * np.pi * phase)) * 0.75 ** np.floor(phase)
            begin_s += length_s + rng.uniform(*every_s)
        return track

    def speech(
        self, phrase_s: Range = (1.6, 4.5), pause_s: Range = (0.4, 1.3)
    ) -> dict[str, Float64Array]:
        """Phrases of 4 to 5 syllables a second, each with its own vowel and weight, and pauses: the
        tracks of `SPEECH_WIDTHS_S`, each about [0, 1]."""
        rng, times_s = self.rng, self.times_s
        # Knots (time, value) of each track; the gaps between them are filled by straight lines and
        # rounded off.
        knots: dict[str, list[tuple[float, float]]] = {
            name: [(0.0, 0.0)] for name in SPEECH_WIDTHS_S
        }

        def put(name: str, at_s: float, value: float) -> None:
            knots[name].append((at_s, value))

        begin_s = EDGE_S
        while begin_s < times_s[-1] - EDGE_S - phrase_s[0]:
            end_s = min(begin_s + rng.uniform(*phrase_s), times_s[-1] - EDGE_S)
            for name in knots:
                put(name, begin_s, 0.0)
            syllable_s = begin_s
            while syllable_s < end_s - 0.15:
                length_s = float(np.clip(rng.normal(0.22, 0.035), 0.15, 0.32))
                centre_s, next_s = syllable_s + 0.55 * length_s, syllable_s + length_s
                stressed = rng.random() < 0.3
                vowel = rng.random()
                put("jaw", centre_s, rng.uniform(0.75, 1.0) if stressed else rng.uniform(0.3, 0.75))
                put("jaw", next_s, rng.uniform(0.05, 0.3))
                put("rounding", centre_s, rng.uniform(0.6, 1.0) if vowel < 0.35 else 0.0)
                put("spreading", centre_s, rng.uniform(0.5, 1.0) if vowel > 0.65 else 0.1)
                put("stress", centre_s, 1.0 if stressed else 0.0)
                put("closure", centre_s, 0.0)
                put("closure", next_s, rng.uniform(0.7, 1.0) if rng.random() < 0.3 else 0.0)
                syllable_s = next_s
            for name in knots:
                put(name, syllable_s + 0.12, 0.0)
            begin_s = syllable_s + 0.12 + rng.uniform(*pause_s)

        return {
            name: smooth(np.interp(times_s, *np.array(knots[name]).T), width_s)
            for name, width_s in SPEECH_WIDTHS_S.items()
        }
