"""Learn the profile of a latent stream: transform, steps and tables, from codes and their effect.

1. *Transform.* A metric says how much a change of the latent changes the rendered image (MSE). In
   coordinates where that metric is the plain distance, one step for all coefficients is right, and
   the Karhunen-Loève transform tells which directions matter. A face moves by muscles, though, a
   few at a time, and those are sparse where principal components are not: so the kept components
   are turned among themselves (an orthogonal turn changes no error) until the coefficients cost the
   fewest bits.
2. *Tables.* The codes are quantised at several qualities, coefficients are counted by place and
   context, and the histograms gathered into a few tables.

Nothing here needs torch or GL; the metric comes from outside (`pica_core.train.stream_metric`).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pica_core.codec.latent_stream import (
    DEFAULT_QUALITY,
    HAS_LATENT,
    HAS_POSE,
    IS_STILL,
    quantise,
)
from pica_core.codec.profile import (
    ACTIVITY_LEVELS,
    ACTIVITY_WINDOW,
    ANALYSIS_SHIFT,
    ESCAPE,
    LATENT_BITS,
    MAX_LATENT,
    MAX_SYNTHESIS_SHIFT,
    NUM_CONTEXTS,
    NUM_HEADERS,
    NUM_LENGTHS,
    NUM_POSE,
    NUM_SYMBOLS,
    POSE_BITS,
    UNITS_PER_RMSE,
    StreamProfile,
)
from pica_core.codec.range_coder import TOTAL
from pica_core.errors import ProfileError, ShapeError
from pica_core.latent import LATENT_SHAPE, NUM_LATENT
from pica_core.types import Float64Array, Int64Array

LATENT_STEPS = (80, 64, 48, 36, 28, 20, 14, 10)
"""By quality, in 64ths of a root of rendered MSE."""
ROTATION_STEPS = (24, 20, 14, 12, 10, 8, 6, 4)
"""Unit 2⁻¹⁴ rad. A head turns by 2 to 4 mrad a frame; 12 is 0.7 mrad and leaves an error of 0.3 in
its steps from frame to frame. With 48, half of a head's motion was noise (docs/results.md)."""
TRANSLATION_STEPS = (5, 4, 3, 2, 2, 2, 1, 1)
"""Unit 2⁻¹⁴ m; 2 is 0.12 mm, and a head moves by 0.2 to 0.4 mm a frame."""
TRAINING_QUALITIES = (1, 3, 4, 6)
MIN_LENGTH, MIN_LATENTS = 4, 100
"""Shorter sequences, and fewer latents together, say nothing about what is likely."""
TURN_FRAMES = 8000
"""Frames that the turning for sparseness looks at."""
LEAST_GAIN = 1e-3
"""Directions of less effect on the image than this share of the strongest count as that strong."""


@dataclass(frozen=True, slots=True, eq=False)
class RenderMetric:
    """How much a change of the latent changes the rendered image, to first order."""

    directions: Float64Array
    """Orthonormal rows that the metric speaks of. ``[D, 256]``."""
    gram: Float64Array
    """Rendered MSE (0-255) of an offset a along the directions is aᵀ gram a. ``[D, D]``."""


def learn_profile(
    sequences: Sequence[npt.NDArray[np.floating[Any]]],
    metric: RenderMetric,
    *,
    num_components: int = 60,
    num_tables: int = 32,
    turn_sweeps: int = 6,
) -> StreamProfile:
    """Learn a profile.

    Args:
        sequences: Latents of performances at about 30 frames a second, each ``[T, 8, 8, 4]`` or
            ``[T, 256]``, of several kinds and speeds: what they hold decides the tables.
        num_components: Coefficients kept of the latent: those beyond 60 change the image by an MSE
            below 0.1.
        num_tables: Probability tables (64 gained nothing).
        turn_sweeps: Passes over all pairs of components when turning for sparseness; 0 keeps the
            Karhunen-Loève transform as it is.

    Raises:
        ShapeError: Sequences of another shape, or too short to learn from.
        ProfileError: Latents or a metric that no profile can hold.
    """
    codes = _checked(sequences, metric)
    rng = np.random.default_rng(0)
    mean = np.concatenate(codes).mean(axis=0)
    forward, backward = _transform(codes, mean, metric, num_components, turn_sweeps, rng)
    profile = _without_tables(mean, forward, backward)
    faces = [np.stack([profile.analyse(latent) for latent in code]) for code in codes]
    counts, lengths, headers = _count(profile, faces, rng)
    tables, index = _gather(counts, num_tables, rng)
    qualities = np.full(profile.num_qualities, 1.0)
    qualities[DEFAULT_QUALITY : DEFAULT_QUALITY + 2] = 60, 20  # chosen: most keep the usual one
    return replace(
        profile,
        tables=tables,
        table_index=index,
        pose_tables=np.stack([_frequencies(row + 0.5) for row in lengths]),
        header_table=_frequencies(headers + 0.5),
        quality_table=_frequencies(qualities),
    )


def _checked(
    sequences: Sequence[npt.NDArray[np.floating[Any]]], metric: RenderMetric
) -> list[Float64Array]:
    """The sequences as ``[T, 256]``, if they and the metric can be learned from."""
    shapes = [np.shape(sequence) for sequence in sequences]
    if (
        any(s[1:] not in (LATENT_SHAPE, (NUM_LATENT,)) or s[0] <= MIN_LENGTH for s in shapes)
        or sum(s[0] for s in shapes) < MIN_LATENTS
    ):
        raise ShapeError(
            f"sequences are {shapes[:3]}...; [T, {NUM_LATENT}] of more than {MIN_LENGTH} each and "
            f"{MIN_LATENTS} together are needed"
        )
    codes = [np.asarray(s, np.float64).reshape(-1, NUM_LATENT) for s in sequences]
    largest = MAX_LATENT >> LATENT_BITS
    if not all((np.abs(code) <= largest).all() for code in codes):  # nor is NaN
        raise ProfileError(f"sequences hold latents that are not finite or beyond {largest}")
    if not (np.isfinite(metric.gram).all() and np.isfinite(metric.directions).all()):
        raise ProfileError("the metric is not finite")
    if not metric.gram.any():
        raise ProfileError("the metric is 0: the image does not change with the latent")
    return codes


def _transform(
    codes: list[Float64Array],
    mean: Float64Array,
    metric: RenderMetric,
    num_components: int,
    turn_sweeps: int,
    rng: np.random.Generator,
) -> tuple[Float64Array, Float64Array]:
    """Latent to coefficients ``[256, K]`` and back ``[K, 256]``, unit a root of rendered MSE."""
    values, vectors = np.linalg.eigh(metric.gram)
    values = np.maximum(values, LEAST_GAIN * values.max())
    root = (vectors * np.sqrt(values)) @ vectors.T
    inverse = (vectors / np.sqrt(values)) @ vectors.T
    seen = [(c - mean) @ metric.directions.T @ root for c in codes]
    spread, axes = np.linalg.eigh(np.cov(np.concatenate(seen).T))
    axes = axes[:, np.argsort(spread)[::-1][:num_components]]
    values = np.concatenate(seen) @ axes
    if len(values) > TURN_FRAMES:
        values = values[rng.choice(len(values), TURN_FRAMES, replace=False)]
    turn = _sparse_turn(values, turn_sweeps, LATENT_STEPS[4] / UNITS_PER_RMSE)
    # Busy components first: by then the context knows how lively the frame is.
    turn = turn[:, np.argsort(-np.abs(values @ turn).mean(axis=0))]
    axes = axes @ turn
    return metric.directions.T @ root @ axes, axes.T @ inverse @ metric.directions


def _sparse_turn(values: Float64Array, sweeps: int, step: float) -> Float64Array:
    """The orthogonal turn of components that makes them cheapest: Jacobi over pairs.

    The cost of a value x is taken as log2(1 + (x / step)²) / 2 bits.
    """
    parts = np.ascontiguousarray((values / step).T)
    count = len(parts)
    turn = np.eye(count)
    angles = np.linspace(-np.pi / 4, np.pi / 4, 17)

    def bits(a: Float64Array, b: Float64Array) -> float:
        return float(np.log1p(a * a).sum()) + float(np.log1p(b * b).sum())

    def turned(a: Float64Array, b: Float64Array, angle: float) -> tuple[Float64Array, Float64Array]:
        c, s = np.cos(angle), np.sin(angle)
        return c * a + s * b, c * b - s * a

    for _ in range(sweeps):
        for i, j in itertools.combinations(range(count), 2):
            best, best_angle = bits(parts[i], parts[j]), 0.0
            for angle in angles:
                cost = bits(*turned(parts[i], parts[j], angle))
                if cost < best:
                    best, best_angle = cost, angle
            if best_angle:
                parts[i], parts[j] = turned(parts[i], parts[j], best_angle)
                turn[:, i], turn[:, j] = turned(turn[:, i], turn[:, j], best_angle)
        angles *= 0.6
    return turn


def _without_tables(
    mean: Float64Array, forward: Float64Array, backward: Float64Array
) -> StreamProfile:
    """A profile with all arrays but the learned tables, which are flat."""
    units = 1 << LATENT_BITS
    analysis = np.rint(forward * UNITS_PER_RMSE / units * (1 << ANALYSIS_SHIFT))
    back = backward * units / UNITS_PER_RMSE
    shift = int(np.floor(np.log2(32767 / max(np.abs(back).max(), 1e-9))))
    shift = min(max(shift, 0), MAX_SYNTHESIS_SHIFT)
    synthesis = np.rint(back * (1 << shift))
    for name, array in (("analysis", analysis), ("synthesis", synthesis)):
        if np.abs(array).max() > 32767:
            raise ProfileError(
                f"stream.{name} reaches {np.abs(array).max():.0f}; 32767 is the largest. "
                "Does the image change at all with the latent?"
            )
    count = forward.shape[1]
    steps = np.array([LATENT_STEPS, ROTATION_STEPS, TRANSLATION_STEPS], np.int32).T
    return StreamProfile(
        mean=np.rint(mean * units).astype(np.int32),
        analysis=analysis.astype(np.int16),
        synthesis=synthesis.astype(np.int16),
        synthesis_shift=np.array([shift], np.int32),
        steps=np.repeat(steps, (count, 3, 3), axis=1),
        tables=_frequencies(np.ones(NUM_SYMBOLS))[None],
        table_index=np.zeros((count, NUM_CONTEXTS), np.uint8),
        pose_tables=np.stack([_frequencies(np.ones(NUM_LENGTHS))] * NUM_POSE),
        header_table=_frequencies(np.ones(NUM_HEADERS)),
        quality_table=_frequencies(np.ones(len(steps))),
    )


def _count(
    profile: StreamProfile, faces: Sequence[Int64Array], rng: np.random.Generator
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Count what would be written of performances: coefficients ``[K, contexts, symbols]``, lengths
    of pose coefficients ``[6, lengths]`` and headers ``[headers]``."""
    count = profile.num_components
    counts = np.zeros((count, NUM_CONTEXTS, NUM_SYMBOLS))
    lengths = np.zeros((NUM_POSE, NUM_LENGTHS))
    headers = np.zeros(NUM_HEADERS)
    for face in faces:
        pose = _wandering_pose(len(face), rng)
        for quality in TRAINING_QUALITIES:
            steps = profile.steps[quality]
            values = quantise(face, steps[:count])
            symbols = 2 * np.minimum(np.abs(values), ESCAPE) - (values > 0)
            np.add.at(counts, (np.arange(count), _contexts(values), symbols), 1)
            turned = np.abs(quantise(pose, steps[count:]))
            places = np.arange(NUM_POSE)
            np.add.at(lengths, (places, np.ceil(np.log2(turned + 1)).astype(np.int64)), 1)
            header = HAS_LATENT * values.any(axis=1) + HAS_POSE * turned.any(axis=1)
            np.add.at(headers, header, 1)
            np.add.at(headers, header + IS_STILL, 0.02)
    return counts, lengths, headers


def _contexts(values: Int64Array) -> Int64Array:
    """The context of each coefficient, ``[T, K]`` both."""
    sums = np.pad(np.abs(values).cumsum(axis=1), ((0, 0), (1, 0)))
    ends = np.arange(values.shape[1])
    before = sums[:, ends] - sums[:, np.maximum(ends - ACTIVITY_WINDOW, 0)]
    made: Int64Array = sum((before >= level).astype(np.int64) for level in ACTIVITY_LEVELS)
    return made


def _wandering_pose(length: int, rng: np.random.Generator) -> Int64Array:
    """A head that nods, turns and rests, as pose coefficients ``[T, 6]``."""
    times = np.arange(length)[:, None] / 30.0
    pose = np.zeros((length, NUM_POSE))
    for period_s, reach in ((rng.uniform(4, 12), 1.0), (rng.uniform(0.7, 2.0), 0.25)):
        phase = rng.uniform(0, 2 * np.pi, (1, NUM_POSE))
        strength = reach * rng.uniform(0.2, 1.0, (1, NUM_POSE))
        pose += strength * np.sin(2 * np.pi * times / period_s + phase)
    pose *= np.array([0.05] * 3 + [0.006] * 3) * rng.choice([0.0, 0.3, 1.0])
    noise = rng.normal(0, [0.0005] * 3 + [0.0001] * 3, (length, NUM_POSE)) * rng.choice([0.0, 1.0])
    made: Int64Array = np.rint((pose + noise) * (1 << POSE_BITS)).astype(np.int64)
    return made


def _gather(
    counts: Float64Array, num_tables: int, rng: np.random.Generator
) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint8]]:
    """Gather histograms into a few tables: k-means with cross-entropy as distance.

    Rare contexts lean on all coefficients in the same context, and the signs of a coefficient are
    taken as alike.
    """
    mirrored = counts.copy()
    mirrored[..., 1::2], mirrored[..., 2::2] = counts[..., 2::2], counts[..., 1::2]
    counts = (counts + mirrored) / 2
    prior = 0.7 ** ((np.arange(NUM_SYMBOLS) + 1) // 2)
    pooled = counts.sum(axis=0, keepdims=True) + 5 * prior / prior.sum()
    pooled /= pooled.sum(axis=-1, keepdims=True)
    shares = (counts + 12 * pooled) / (counts.sum(axis=-1, keepdims=True) + 12)
    rows, weights = shares.reshape(-1, NUM_SYMBOLS), counts.sum(axis=-1).reshape(-1) + 0.1
    order = np.argsort(-(rows * np.log2(rows)).sum(axis=1))
    ladder = np.linspace(0, len(order) - 1, num_tables).astype(int)
    centres = rows[order[ladder]].copy()
    belongs = np.zeros(len(rows), int)
    for _ in range(20):
        belongs = np.argmin(-(rows @ np.log2(centres).T), axis=1)
        for centre in range(num_tables):
            members = belongs == centre
            if members.any():
                centres[centre] = np.average(rows[members], axis=0, weights=weights[members])
            else:  # an empty table takes a new place among the costly histograms
                centres[centre] = rows[rng.integers(len(rows))]
    belongs = np.argmin(-(rows @ np.log2(centres).T), axis=1)
    tables = np.stack([_frequencies(row) for row in centres])
    return tables, belongs.reshape(counts.shape[:-1]).astype(np.uint8)


def _frequencies(weights: Float64Array) -> npt.NDArray[np.uint16]:
    """Integer frequencies in proportion to weights: at least 1 each, `TOTAL` together."""
    spare = TOTAL - len(weights)
    exact = weights / weights.sum() * spare
    floors = np.floor(exact).astype(np.int64)
    order = np.argsort(-(exact - floors), kind="stable")
    floors[order[: spare - int(floors.sum())]] += 1
    made: npt.NDArray[np.uint16] = (floors + 1).astype(np.uint16)
    return made
