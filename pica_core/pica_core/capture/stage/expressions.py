"""What the subject does on the stage: takes of 52 ARKit values at 30 Hz, made from a seed.

A take is low rank, as real faces are: a few visemes, emotions and gestures blend into each other,
the two sides move together, eyes blink and jump. Whole takes are held out
for testing, so no test frame has a neighbour in the training set.
"""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter1d

from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES, NUM_ARKIT
from pica_core.capture.dataset.files import Take
from pica_core.files import packaged_json
from pica_core.types import Float64Array, FloatArray

Generator = np.random.Generator

RATE_HZ = 30.0


def blend(**values: float) -> Float64Array:
    """An expression by name; a name without its side (``mouthSmile``) means both sides."""
    arkit = np.zeros(NUM_ARKIT)
    for name, value in values.items():
        for full in (name, f"{name}Left", f"{name}Right"):
            if full in ARKIT_INDEX:
                arkit[ARKIT_INDEX[full]] = value
    return arkit


_TABLE = packaged_json("pica_core.capture.stage", "expressions.json")
VISEMES = tuple(blend(**values) for values in _TABLE["visemes"])
"""Mouth shapes of speech: AA, EE, OH, OO, M-B-P, F-V, D-T, L-TH, S-Z, EH, rest."""
MOODS = tuple(blend(**values) for values in _TABLE["moods"])
"""Slow, whole-face states."""


def _smooth(values: Float64Array, seconds: float) -> Float64Array:
    """Gaussian smoothing over time with the ends held; `seconds` is the standard deviation."""
    sigma = seconds * RATE_HZ
    radius = max(int(3 * sigma), 1)
    return gaussian_filter1d(values, sigma, axis=0, mode="nearest", radius=radius)


def _stairs(frames: int, step: Callable[[], tuple[int, Float64Array]]) -> Float64Array:
    """One state after the other, each for so many frames as comes with it. ``[frames, n]``."""
    states: list[Float64Array] = []
    while len(states) < frames:
        length, state = step()
        states += length * [state]
    return np.array(states[:frames])


def _hold(
    random: Generator, frames: int, choices: tuple[Float64Array, ...], mean_s: float
) -> Float64Array:
    """A staircase: one choice after the other, of random strength and length, a little uneven."""

    def step() -> tuple[int, Float64Array]:
        length = max(int(random.gamma(4.0, mean_s / 4.0) * RATE_HZ), 2)
        state = choices[int(random.integers(len(choices)))] * random.uniform(0.5, 1.15)
        if random.random() < 0.4:
            state = state + 0.5 * random.random() * choices[int(random.integers(len(choices)))]
        return length, state * random.uniform(0.88, 1.12, NUM_ARKIT)

    return _stairs(frames, step)


def _eyes(random: Generator, frames: int) -> Float64Array:
    """Blinks and gaze jumps; both eyes together."""

    def jump() -> tuple[int, Float64Array]:
        return int(random.gamma(2.0, 0.5) * RATE_HZ) + 6, random.normal(0.0, [0.35, 0.22])

    result = np.zeros((frames, NUM_ARKIT))
    gaze = np.clip(_smooth(_stairs(frames, jump), 0.03), -1, 1)
    for names, value in (
        (("OutLeft", "InRight"), gaze[:, 0]),
        (("InLeft", "OutRight"), -gaze[:, 0]),
        (("UpLeft", "UpRight"), gaze[:, 1]),
        (("DownLeft", "DownRight"), -gaze[:, 1]),
    ):
        for name in names:
            result[:, ARKIT_INDEX[f"eyeLook{name}"]] = np.clip(value, 0, 1)
    at = int(random.uniform(0.3, 1.5) * RATE_HZ)
    shape = np.array([0.35, 0.9, 1.0, 0.85, 0.5, 0.2])
    both = [ARKIT_INDEX["eyeBlinkLeft"], ARKIT_INDEX["eyeBlinkRight"]]
    while at < frames:
        span = shape[: frames - at, None]
        result[at : at + len(span), both] = np.maximum(result[at : at + len(span), both], span)
        at += int(random.gamma(3.0, 0.8) * RATE_HZ) + 8
    return result


def sentence(random: Generator, frames: int) -> FloatArray:
    """Speech: six visemes a second over a slow mood, brow accents, blinks, gaze. ``[T, 52]``."""
    mouth = _smooth(_hold(random, frames, VISEMES, 0.17), 0.045)
    mood = _smooth(_hold(random, frames, MOODS[:7], 2.5), 0.35) * random.uniform(0.2, 0.7)
    accent_shapes = (blend(), blend(), blend(browInnerUp=0.5, browOuterUp=0.4), blend(browDown=0.4))
    accents = _smooth(_hold(random, frames, accent_shapes, 0.7), 0.12)
    drift = _smooth(random.normal(0, 0.25, (frames, NUM_ARKIT)), 0.5) * 0.35
    drift[:, :14] = 0.0
    return np.clip(
        mouth + mood + accents + np.maximum(drift, 0) + _eyes(random, frames), 0, 1.05
    ).astype(np.float32)


def range_of_motion(random: Generator, frames: int) -> FloatArray:
    """One shape after the other to its full extent, pairs together or alone. ``[T, 52]``."""
    pairs = [name.removesuffix("Left") for name in ARKIT_NAMES if name.endswith("Left")]
    single = [name for name in ARKIT_NAMES if not name.endswith(("Left", "Right"))]
    single += ["jawLeft", "jawRight", "mouthLeft", "mouthRight"]
    result = np.zeros((frames, NUM_ARKIT))
    order: list[tuple[str, ...]] = []
    for name in pairs:
        if name not in ("jaw", "mouth"):
            order += [(name,), (f"{name}Left",), (f"{name}Right",)]
    order += [(name,) for name in single if name != "mouthClose"]
    order += [("jawOpen", "mouthClose"), ("jawOpen",), ("jawOpen", "mouthSmile"), ("eyeBlink",)]
    length = max(frames // len(order), 3)
    envelope = np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 0.7
    for slot, index in enumerate(random.permutation(len(order))):
        start = slot * length
        if start >= frames:
            break
        strength = random.uniform(0.6, 1.0)
        state = blend(**{name: strength for name in order[index]})
        part = result[start : start + length]
        part += envelope[: len(part), None] * state
    idle = _smooth(_hold(random, frames, MOODS[:6], 1.5), 0.3) * 0.2
    return np.clip(result + idle, 0, 1).astype(np.float32)


def combinations(random: Generator, frames: int) -> FloatArray:
    """Strong moods and gestures blending into each other, with gaze and blinks. ``[T, 52]``."""
    strong = _smooth(_hold(random, frames, MOODS, 0.8), 0.12)
    talk = _smooth(_hold(random, frames, VISEMES, 0.3), 0.08) * random.uniform(0.0, 0.6)

    def two() -> tuple[int, Float64Array]:
        length, state = int(random.uniform(0.3, 0.8) * RATE_HZ), np.zeros(NUM_ARKIT)
        chosen = random.choice(NUM_ARKIT, 2, replace=False)
        state[chosen] = random.uniform(0.2, 0.8, 2)
        return length, state

    lone = _stairs(frames, two)
    lone[:, :14] *= 0.5
    lone = _smooth(lone, 0.1) * 0.6
    lone[:, ARKIT_INDEX["mouthClose"]] = 0.0
    return np.clip(strong + talk + lone + _eyes(random, frames), 0, 1).astype(np.float32)


def crowded(random: Generator, frames: int) -> FloatArray:
    """Many shapes at once, whatever the others do, as trackers send them. ``[T, 52]``.

    A tracker spreads one look over many shapes: in a real recording 7 shapes lie above 0.3 at a
    time and the mouth's add up to 3.1 (medians), in the takes above to 4 and 1.3 (measured).
    """
    moments = _stairs(frames, lambda: (int(random.integers(4, 8)), _crowd(random)))
    return np.clip(_smooth(moments, 0.03), 0, 1).astype(np.float32)


def _crowd(random: Generator) -> Float64Array:
    """One moment of `crowded`: half of all shapes, four pairs of five in step. ``[52]``."""
    on = (random.random(NUM_ARKIT) < 0.5) * random.uniform(0.1, 1.0, NUM_ARKIT) ** 0.8
    state = dict(zip(ARKIT_NAMES, on, strict=True))
    for name in ARKIT_NAMES:
        stem = name.removesuffix("Left")
        if stem in ("jaw", "mouth"):  # a direction, and the other is its opposite
            state[f"{stem}{random.choice(['Left', 'Right'])}"] = 0.0
        elif stem != name and random.random() < 0.8:
            state[f"{stem}Right"] = state[name] * random.uniform(0.9, 1.1)
    mouth = [name for name in ARKIT_NAMES if name.startswith(("mouth", "cheekPuff"))]
    most = random.uniform(3.0, 7.5) / max(sum(state[name] for name in mouth), 1e-9)
    state |= {name: state[name] * min(most, 1.0) for name in mouth}
    state["tongueOut"] = (random.random() < 0.12) * random.uniform(0.3, 1.0)
    if state["tongueOut"]:
        state["jawOpen"] = max(state["jawOpen"], 0.3)
    state["mouthClose"] = (random.random() < 0.35) * random.uniform(0.2, 1.0) * state["jawOpen"]
    across, up = np.clip(random.uniform(-1.2, 1.2, 2), -1, 1)
    squint = (random.random() < 0.3) * random.uniform(0.0, 0.4)
    for side, out in (("Left", across - squint), ("Right", -across - squint)):
        state[f"eyeWide{side}"] *= 1 - min(state[f"eyeBlink{side}"], 1.0)
        for name, value in (("Out", out), ("In", -out), ("Up", up), ("Down", -up)):
            state[f"eyeLook{name}{side}"] = max(value, 0.0)
    return np.array(list(state.values()))


def lids_and_gaze(random: Generator, frames: int) -> FloatArray:
    """Eyes alone: lids at every height, together or one at a time, gaze everywhere. ``[T, 52]``.

    Blinks are short, so that performances hold few frames of a closed eye; an avatar that never
    learned them stares.
    """
    lids = [blend(eyeBlink=closed) for closed in (0.0, 0.5, 0.75, 1.0, 1.0)]
    lids += [blend(eyeBlinkLeft=1.0), blend(eyeBlinkRight=1.0), blend(eyeSquint=0.8)]
    lids += [blend(eyeWide=0.8), blend(eyeSquint=0.6, eyeBlink=0.5)]
    look = [
        blend(eyeLookOutLeft=x, eyeLookInRight=x, eyeLookUp=y) for x in (0, 0.8) for y in (0, 0.7)
    ]
    look += [
        blend(eyeLookInLeft=x, eyeLookOutRight=x, eyeLookDown=y)
        for x in (0, 0.8) for y in (0.4, 0.8)
    ]  # fmt: skip
    mouth = _smooth(_hold(random, frames, VISEMES, 0.3), 0.08) * 0.5
    brows = _smooth(_hold(random, frames, MOODS[:6], 1.0), 0.2) * 0.3
    eyes = _smooth(_hold(random, frames, tuple(lids), 0.35), 0.04)
    gaze = _smooth(_hold(random, frames, tuple(look), 0.4), 0.04)
    return np.clip(mouth + brows + eyes + gaze, 0, 1).astype(np.float32)


KINDS = (
    ("ROM", range_of_motion), ("SEN", sentence), ("EXP", combinations), ("ODD", crowded),
)  # fmt: skip
TEST_SHARE = 0.15
"""Share of the frames that are in held-out takes."""
EYE_SHARE = 1 / 6
"""Share of the frames that go to takes of the eyes alone."""
TAKE_FRAMES = 40
"""Captured frames of a take, at most."""
STRIDE = 5
"""Every so many frames of a performance one is captured."""
FIRST_TEST_TAKE = 500


def sample_takes(num_frames: int, seed: int) -> list[Take]:
    """Plan a capture: takes with `num_frames` (at least 4) captured frames in all.

    A sixth of the frames is for the eyes alone, the rest in about equal shares per kind. The first
    frame of the first take is the neutral face; `TEST_SHARE` of the frames are in held-out takes.
    """
    num_eyes = int(num_frames * EYE_SHARE)
    num_test = max(round((num_frames - num_eyes) * TEST_SHARE), 1)
    quota = {"train": num_frames - num_eyes - num_test, "test": num_test}
    takes: list[Take] = []
    for split, total in quota.items():
        # Tests are sentences and combinations; the others are there to be learned.
        kinds = KINDS if split == "train" else KINDS[1:3]
        per_kind = [total // len(kinds) + (k < total % len(kinds)) for k in range(len(kinds))]
        for (label, make), count in zip(kinds, per_kind, strict=True):
            takes += _takes(label, make, count, split, seed)
    takes[0].arkit[0] = 0.0
    num_test_eyes = round(num_eyes * TEST_SHARE)
    for split, count in (("train", num_eyes - num_test_eyes), ("test", num_test_eyes)):
        takes += _takes("EYE", lids_and_gaze, count, split, seed)
    return takes


def _takes(
    label: str, make: Callable[[Generator, int], FloatArray], count: int, split: str, seed: int
) -> list[Take]:
    """Takes of one kind with `count` captured frames in all."""
    takes = []
    code = sum(ord(letter) << (8 * place) for place, letter in enumerate(label))
    for part in range(0, count, TAKE_FRAMES):
        size = min(TAKE_FRAMES, count - part)
        index = part // TAKE_FRAMES + (0 if split == "train" else FIRST_TEST_TAKE)
        random = np.random.default_rng([seed, code, index])
        performed = make(random, size * STRIDE + 20)
        moments = 10 + STRIDE * np.arange(size)
        segment = f"{label}{index:03d}"
        takes.append(Take(segment=segment, arkit=performed[moments], split=split))
    return takes


STREAM_FRAMES = 120
"""Length of each, at 30 frames a second."""
STRENGTHS = (1.0, 0.7)
STREAM_KINDS: tuple[tuple[Callable[[Generator, int], FloatArray], int], ...] = (
    (sentence, 1),
    (range_of_motion, 1),
    (combinations, 1),
    (lids_and_gaze, 3),
)
"""Each with how rarely it comes: eyes alone every third round."""


def stream_training_expressions(rounds: int = 36, seed: int = 0) -> FloatArray:
    """Draw `rounds` performances of each kind, in several strengths: ARKit values, float32
    ``[N, 52]``. Recordings and the client's performances are for testing."""
    performances = []
    for number in range(rounds):
        for kind, (make, rarity) in enumerate(STREAM_KINDS):
            if number % rarity == 0:
                values = make(np.random.default_rng([seed, number, kind]), STREAM_FRAMES)
                performances.append(values * np.float32(STRENGTHS[number % len(STRENGTHS)]))
    return np.concatenate(performances)
