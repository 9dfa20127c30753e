"""Performances that ship with the package: generated faces with the statistics of real ones.

    talk             a person tells a story: phrases, pauses, stress with brows and head
    listen           a person follows it: nods, smiles, a short answer now and then
    range_of_motion  every muscle once, as actors do before a capture

No person was recorded for these; results on them are not results on people. What they share with
seven real Live Link Face takes is checked by `tests/client/test_performances.py`: few principal
components (talk: 95 % of the variance in 5 or 6), a mean step of 0.001 to 0.006 a frame with jumps
at blinks, values in [0, 1], and mouthClose never more than 0.07 above jawOpen (it is a corrective:
alone it is nonsense).

The same name and seed give the same performance on every machine.
"""

from collections.abc import Callable, Mapping

import numpy as np

from pica_client.errors import SourceError
from pica_client.sources.source import Recording
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.types import Float64Array, FloatArray

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
"""What moves during speech, and over how much each of these tracks is rounded off."""


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


DURATION_S = 60.0
"""Length of a performance before it repeats."""
MOUTH_CLOSE_MARGIN = 0.07
"""Largest mouthClose minus jawOpen in seven real recordings."""
NECK_TO_HEAD_M = 0.12
"""From the joint that a head turns about up to the origin between the ears (chosen: an adult's,
roughly)."""

REST = {
    **{f"eyeBlink{side}": 0.09 for side in ("Left", "Right")},
    **{f"eyeLookDown{side}": 0.10 for side in ("Left", "Right")},
    **{f"mouthSmile{side}": 0.05 for side in ("Left", "Right")},
    **{f"mouthStretch{side}": 0.06 for side in ("Left", "Right")},
    "mouthFunnel": 0.04,
    "mouthPucker": 0.06,
    "mouthShrugUpper": 0.06,
    "mouthShrugLower": 0.06,
    "browInnerUp": 0.06,
    "jawForward": 0.03,
}
"""A face at rest as trackers see it: not all zero."""
SPEECH = {
    "jaw": {"jawOpen": 0.52, "mouthLowerDown": 0.30, "mouthUpperUp": 0.15, "jawForward": 0.03},
    "rounding": {"mouthFunnel": 0.36, "mouthPucker": 0.34, "mouthStretch": -0.05},
    "spreading": {
        **{"mouthStretch": 0.14, "mouthSmile": 0.08, "mouthDimple": 0.04, "mouthLowerDown": 0.05}
    },
    "closure": {
        **{"mouthPress": 0.09, "mouthRollLower": 0.08, "mouthRollUpper": 0.05, "jawOpen": 0.03}
    },
}
"""Shapes that each track of speech moves."""


class Mixer:
    """Adds movements to a face at rest, shape by shape."""

    def __init__(self, num_samples: int) -> None:
        self.values = np.zeros((num_samples, NUM_ARKIT))
        self.add(np.ones(num_samples), REST)

    def add(self, track: Float64Array, weights: Mapping[str, float]) -> None:
        """Add a movement. A name without a side stands for both sides where the shape has sides."""
        for name, weight in weights.items():
            names = (name,) if name in ARKIT_INDEX else (f"{name}Left", f"{name}Right")
            for each in names:
                self.values[:, ARKIT_INDEX[each]] += weight * track

    def blink(self, track: Float64Array) -> None:
        """Close both lids; a blink covers whatever the lids did before."""
        for side, strength in (("Left", 1.0), ("Right", 0.98)):
            column = self.values[:, ARKIT_INDEX[f"eyeBlink{side}"]]
            np.maximum(column, strength * track, out=column)

    def look(self, left: Float64Array, up: Float64Array) -> None:
        """Turn both eyes, lids following the gaze down."""
        self.add(np.maximum(left, 0), {"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0})
        self.add(np.maximum(-left, 0), {"eyeLookInLeft": 1.0, "eyeLookOutRight": 1.0})
        self.add(np.maximum(up, 0), {"eyeLookUp": 1.0, "eyeWide": 0.15})
        self.add(np.maximum(-up, 0), {"eyeLookDown": 1.0, "eyeBlink": 0.3})

    def speak(self, speech: Mapping[str, Float64Array], loudness: float) -> None:
        """Move the mouth as `speech` says."""
        for name, weights in SPEECH.items():
            self.add(speech[name] * loudness, weights)
        # Lips that meet over an open jaw: the corrective takes back as much of the jaw as there is.
        jaw = self.values[:, ARKIT_INDEX["jawOpen"]]
        self.values[:, ARKIT_INDEX["mouthClose"]] += 0.6 * np.clip(speech["closure"], 0, 1) * jaw

    def finish(self) -> FloatArray:
        """The values as a tracker would give them. float32 ``[T, 52]``."""
        values = np.clip(self.values, 0, 1)
        close, jaw = ARKIT_INDEX["mouthClose"], ARKIT_INDEX["jawOpen"]
        values[:, close] = np.minimum(values[:, close], values[:, jaw] + 0.9 * MOUTH_CLOSE_MARGIN)
        return values.astype(np.float32)


def _talk(mixer: Mixer, player: Player) -> Float64Array:
    speech = player.speech()
    mixer.speak(speech, 1.1)
    mood = np.clip(player.drift(period_s=(9, 20)), 0, 1)
    mixer.add(mood, {"mouthSmile": 0.5, "cheekSquint": 0.26, "eyeSquint": 0.18, "mouthDimple": 0.1})
    brows = smooth(speech["stress"] * (player.drift(period_s=(3, 8)) > 0), 0.15)
    mixer.add(brows, {"browInnerUp": 0.45, "browOuterUp": 0.38, "eyeWide": 0.1})
    frown = np.clip(player.drift(period_s=(6, 15)) - 0.25, 0, 1)
    mixer.add(frown, {"browDown": 0.08})
    mixer.look(*player.saccades(spread=0.075, rest_s=(0.6, 2.5), away=0.3))
    mixer.blink(player.blinks(every_s=(2.0, 5.0)))
    nods = player.nods(every_s=(8, 16))
    return 0.05 * smooth(speech["stress"], 0.2) + 0.06 * nods


def _listen(mixer: Mixer, player: Player) -> Float64Array:
    answers = player.speech(phrase_s=(0.5, 1.0), pause_s=(3.0, 6.0))
    mixer.speak(answers, 0.6)
    smile = np.clip(1.4 * player.drift(period_s=(7, 16)), 0, 1)
    mixer.add(
        smile, {"mouthSmile": 0.55, "cheekSquint": 0.3, "eyeSquint": 0.2, "mouthDimple": 0.15}
    )
    interest = np.clip(1.4 * player.drift(period_s=(5, 12)) - 0.2, 0, 1)
    mixer.add(interest, {"browInnerUp": 0.5, "browOuterUp": 0.4, "eyeWide": 0.12})
    doubt = np.clip(1.4 * player.drift(period_s=(8, 18)) - 0.4, 0, 1)
    mixer.add(doubt, {"browDown": 0.4, "mouthPress": 0.25, "mouthPucker": 0.2, "mouthLeft": 0.15})
    mixer.look(*player.saccades(spread=0.09, rest_s=(1.0, 4.0), away=0.15))
    mixer.blink(player.blinks(every_s=(2.0, 5.0)))
    return 0.11 * player.nods(every_s=(2.5, 6.0))


MOTIONS: tuple[Mapping[str, float], ...] = (
    {"jawOpen": 1.0, "mouthLowerDown": 0.4, "mouthUpperUp": 0.2},
    {"mouthSmile": 0.9, "cheekSquint": 0.6, "eyeSquint": 0.4, "mouthDimple": 0.3},
    {"browInnerUp": 0.9, "browOuterUp": 0.9, "eyeWide": 0.7},
    {"browDown": 0.9, "noseSneer": 0.6, "eyeSquint": 0.5, "mouthUpperUp": 0.4},
    {"mouthPucker": 0.8, "mouthFunnel": 0.5},
    {"mouthFunnel": 0.85, "jawOpen": 0.35, "mouthUpperUp": 0.2},
    {"mouthFrown": 0.8, "mouthShrugLower": 0.6, "mouthShrugUpper": 0.3, "browInnerUp": 0.4},
    {"eyeBlink": 0.95, "cheekSquint": 0.3, "eyeSquint": 0.5},
    {"mouthLeft": 0.55, "jawLeft": 0.2, "mouthDimpleLeft": 0.3, "mouthSmileLeft": 0.2},
    {"mouthRight": 0.55, "jawRight": 0.2, "mouthDimpleRight": 0.3, "mouthSmileRight": 0.2},
    {"cheekPuff": 0.35, "mouthPress": 0.2, "mouthRollLower": 0.3},
    {"mouthRollLower": 0.4, "mouthRollUpper": 0.35, "mouthPress": 0.25, "jawOpen": 0.06},
    {"mouthStretch": 0.8, "mouthLowerDown": 0.7, "mouthFrown": 0.3, "jawOpen": 0.15},
    {"tongueOut": 0.8, "jawOpen": 0.5, "mouthLowerDown": 0.3},
    {"jawForward": 0.3, "mouthShrugLower": 0.3, "mouthLowerDown": 0.2},
    {"eyeLookUp": 0.3, "browInnerUp": 0.3, "eyeWide": 0.2},
    {"eyeLookDown": 0.7, "eyeBlink": 0.35},
    {"eyeLookOutLeft": 0.3, "eyeLookInRight": 0.3},
    {"eyeLookInLeft": 0.3, "eyeLookOutRight": 0.3},
    {"jawOpen": 0.5, "mouthClose": 0.45, "mouthPucker": 0.2},
)
"""What an actor is asked for, one after the other; sides together where no side is named."""


def _range_of_motion(mixer: Mixer, player: Player) -> Float64Array:
    rng, times_s = player.rng, player.times_s
    slot_s = (times_s[-1] - 2 * EDGE_S) / len(MOTIONS)
    for index, motion in enumerate(rng.permutation(len(MOTIONS))):
        begin_s = EDGE_S + (index + rng.uniform(0.0, 0.12)) * slot_s
        shape = bump(times_s, begin_s, rng.uniform(0.2, 0.45), 0.3 * slot_s, rng.uniform(0.25, 0.5))
        strength = rng.uniform(0.85, 1.0)
        mixer.add(strength * shape, MOTIONS[motion])
    mixer.look(*player.saccades(spread=0.04, rest_s=(1.0, 3.0)))
    mixer.blink(player.blinks())
    return 0.05 * player.nods(every_s=(6.0, 12.0))


PERFORMANCES: dict[str, Callable[[Mixer, Player], Float64Array]] = {
    "talk": _talk,
    "listen": _listen,
    "range_of_motion": _range_of_motion,
}
"""Each moves the face, and gives the head's pitch (radians, chin down positive), over the sample
times."""


def make_performance(name: str, *, seed: int = 0, start_s: float = 0.0) -> Recording:
    """Generate a performance.

    Args:
        name: One of `PERFORMANCES`.
        seed: Chooses the player: same manner, other words. 0 to 2³²−1.
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
    # Every name has its own generator, so that talk#1 and listen#1 do not blink together.
    player = Player(np.random.default_rng([seed, *name.encode()]), DURATION_S)
    times_s = player.times_s
    mixer = Mixer(len(times_s))
    pitch = PERFORMANCES[name](mixer, player)

    def drift() -> Float64Array:
        return player.drift(period_s=(4.0, 11.0))

    rotation = np.stack((pitch + 0.035 * drift(), 0.09 * drift(), 0.03 * drift()), axis=1)
    # The head turns about the neck: its origin swings along, and the body sways a little under it.
    swing = np.stack((-rotation[:, 2], np.zeros_like(times_s), rotation[:, 0]), axis=1)
    sway = np.stack([drift() for _ in range(3)], axis=1)
    return Recording(
        times_s=times_s,
        arkit=mixer.finish(),
        rotation=rotation.astype(np.float32),
        translation_m=(NECK_TO_HEAD_M * swing + 0.004 * sway).astype(np.float32),
        has_face=np.ones(len(times_s), np.bool_),
        loop_gap_s=1 / SAMPLE_FPS,
        start_s=start_s,
    )
