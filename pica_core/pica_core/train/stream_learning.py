"""Learn the profile of a latent stream, transform and choice of tables, from codes and effects.

1. *Transform.* A metric says how much a change of the latent changes the rendered image (MSE). In
   coordinates where that metric is the plain distance, one step for all coefficients is right, and
   the Karhunen-Loève transform tells which directions matter. A face moves by muscles, though, a
   few at a time, and those are sparse where principal components are not: so the kept components
   are turned among themselves (an orthogonal turn changes no error) until the coefficients cost the
   fewest bits. Without the turn a payload has a fifth more.
2. *Tables.* The codes are quantised at several qualities, coefficients are counted by place and
   context, and each histogram takes the table that codes it in the fewest bits.

Nothing here needs torch or GL; the metric comes from outside (`pica_core.train.export`).
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from pica_core.codec.latent_stream import STEPS, quantise, steps_of
from pica_core.codec.profile import (
    ACTIVITY_LEVELS,
    ACTIVITY_WINDOW,
    ANALYSIS_SHIFT,
    ESCAPE,
    LATENT_BITS,
    MAX_SYNTHESIS_SHIFT,
    NUM_CONTEXTS,
    NUM_SYMBOLS,
    TOTAL,
    UNITS_PER_RMSE,
    StreamProfile,
    coefficient_frequencies,
)
from pica_core.errors import ProfileError
from pica_core.types import Float64Array, Int64Array

TRAINING_QUALITIES = (1, 3, 4, 6)
TURN_FRAMES = 8000
"""Frames that the turning for sparseness looks at."""
LEAST_GAIN = 1e-3
"""Directions of less effect on the image than this share of the strongest count as that strong."""
POOLED = 4.0
"""How many coefficients of all places together are added to those of each: rare contexts lean on
them."""


@dataclass(frozen=True, slots=True, eq=False)
class RenderMetric:
    """How much a change of the latent changes the rendered image, to first order."""

    directions: Float64Array
    """Orthonormal rows that the metric speaks of. ``[D, 256]``."""
    gram: Float64Array
    """Rendered MSE (0-255) of an offset a along the directions is aᵀ gram a. ``[D, D]``."""


def learn_profile(
    codes: Float64Array,
    metric: RenderMetric,
    *,
    num_components: int = 60,
    turn_sweeps: int = 6,
) -> StreamProfile:
    """Learn a profile.

    Args:
        codes: Latents of faces of several kinds, which decide the tables. ``[N, 256]``.
        num_components: Coefficients kept of the latent: those beyond 60 change the image by an MSE
            below 0.1.
        turn_sweeps: Passes over all pairs of components when turning for sparseness.

    Raises:
        ProfileError: Latents or a metric that no profile can hold.
    """
    if not np.isfinite(metric.gram).all():
        raise ProfileError("the metric is not finite")
    if not metric.gram.any():
        raise ProfileError("the metric is 0: the image does not change with the latent")
    mean = codes.mean(axis=0)
    forward, backward = _transform(codes, mean, metric, num_components, turn_sweeps)
    profile = _without_tables(mean, forward, backward)
    counts = np.zeros((profile.num_components, NUM_CONTEXTS, NUM_SYMBOLS))
    places = np.arange(profile.num_components)
    faces = np.stack([profile.analyse(code) for code in codes])
    for quality in TRAINING_QUALITIES:
        values = quantise(faces, steps_of(quality, len(places))[: len(places)])
        symbols = 2 * np.minimum(np.abs(values), ESCAPE) - (values > 0)
        np.add.at(counts, (places, _contexts(values), symbols), 1)
    pooled = counts.sum(axis=0)
    counts += POOLED * pooled / np.maximum(pooled.sum(axis=1, keepdims=True), 1)
    bits = -np.log2(coefficient_frequencies() / TOTAL)
    index = (counts @ bits.T).argmin(axis=2).astype(np.uint8)
    return replace(profile, table_index=index)


def _transform(
    codes: Float64Array,
    mean: Float64Array,
    metric: RenderMetric,
    num_components: int,
    turn_sweeps: int,
) -> tuple[Float64Array, Float64Array]:
    """Latent to coefficients ``[256, K]`` and back ``[K, 256]``, unit a root of rendered MSE."""
    values, vectors = np.linalg.eigh(metric.gram)
    values = np.maximum(values, LEAST_GAIN * values.max())
    root = (vectors * np.sqrt(values)) @ vectors.T
    inverse = (vectors / np.sqrt(values)) @ vectors.T
    seen = (codes - mean) @ metric.directions.T @ root
    spread, axes = np.linalg.eigh(np.cov(seen.T))
    axes = axes[:, np.argsort(spread)[::-1][:num_components]]
    values = seen @ axes
    if len(values) > TURN_FRAMES:
        rng = np.random.default_rng(0)
        values = values[rng.choice(len(values), TURN_FRAMES, replace=False)]
    turn = _sparse_turn(values, turn_sweeps, STEPS[4][0] / UNITS_PER_RMSE)
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
    """A profile with all arrays but the choice of tables."""
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
    return StreamProfile(
        mean=np.rint(mean * units).astype(np.int32),
        analysis=analysis.astype(np.int16),
        synthesis=synthesis.astype(np.int16),
        synthesis_shift=np.array([shift], np.int32),
        table_index=np.zeros((forward.shape[1], NUM_CONTEXTS), np.uint8),
    )


def _contexts(values: Int64Array) -> Int64Array:
    """The context of each coefficient, ``[T, K]`` both."""
    sums = np.pad(np.abs(values).cumsum(axis=1), ((0, 0), (1, 0)))
    ends = np.arange(values.shape[1])
    before = sums[:, ends] - sums[:, np.maximum(ends - ACTIVITY_WINDOW, 0)]
    made: Int64Array = sum((before >= level).astype(np.int64) for level in ACTIVITY_LEVELS)
    return made
