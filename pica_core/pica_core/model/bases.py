"""The shape of a face in closed form: a mean and the principal components of training meshes.

    bases = fit_bases(meshes_m, 64, vertex_weights)          seconds, no descent
    meshes_m = bases.positions(bases.weights_of(meshes_m))   [N, V, 3]
    coarse = bases.select(vertices)                          the same of some vertices
    parts = split_bases(bases, vertex_uv)                    by regions of the chart, pruned

A head is nearly linear in its expression, and a part of it much more so: eyeballs turn, teeth
follow the jaw, the back of the head stays. So the components are cut along the chart into regions
of `REGION` vertices, and each region keeps as many directions of its own as it takes to stay
within `TOLERANCE_M`; what does not move keeps none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pica_core.avatar.linear import REGION
from pica_core.avatar.storage import round_signed
from pica_core.errors import CaptureError
from pica_core.types import Float64Array, FloatArray, IntArray

TOLERANCE_M = 1e-5
"""Root mean square distance that a region may lose by its pruning (chosen: a tenth of what vertices
may err; `docs/training.md`)."""
LEAST_FRAMES = 8
"""Fewer good meshes make no bases."""
MOST_FRAMES = 1024
"""Meshes that the components are found from; of more, evenly spaced ones."""
BENT_M = 1e-4
"""Bases are not enough where those of three in four training meshes leave a larger root mean square
error in any region of the others (measured, `docs/training.md`: rigs leave a tenth)."""
JUMP_RATIO = 10.0
JUMP_M = 2e-3
"""A mesh is bad if the others explain it so much worse than a usual one (both, root mean square:
a face that is shown once is off by less)."""
LEAST_SHARE = 1e-9
LEAST_M = 1e-7
"""Components below this share of the first one's variance, or this deviation, are rounding."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Bases:
    """A linear model of meshes: positions = mean + weights . components."""

    mean_m: FloatArray
    """Metres, float32 ``[V, 3]``."""
    components_m: FloatArray
    """Metres per unit of weight, by falling deviation, float32 ``[K, V, 3]``; a weight has about
    deviation 1 over the training meshes."""
    vertex_weights: FloatArray
    """How much an error of each vertex counts, ``[V]``."""
    left_out: tuple[int, ...] = ()
    """Numbers of the meshes that were not used: not finite, or nothing like the others."""

    def positions(self, weights: FloatArray) -> FloatArray:
        """Weights ``[N, K]`` to vertices in metres ``[N, V, 3]``."""
        moved: FloatArray = np.tensordot(weights, self.components_m, axes=1)
        return self.mean_m + moved

    def weights_of(self, meshes_m: FloatArray) -> FloatArray:
        """The weights that come nearest to meshes ``[N, V, 3]``, by least squares: ``[N, K]``."""
        count = len(self.components_m)
        by_root = np.sqrt(self.vertex_weights)[:, None]
        wanted = ((meshes_m - self.mean_m) * by_root).reshape(len(meshes_m), -1)
        columns = (self.components_m * by_root).reshape(count, -1)
        gram = columns.astype(np.float64) @ columns.T
        found = np.linalg.solve(gram, columns @ wanted.T.astype(np.float64)).T
        return np.ascontiguousarray(found, np.float32)

    def select(self, vertices: IntArray) -> Bases:
        """The same weights' effect on some vertices, by their numbers."""
        return Bases(
            mean_m=self.mean_m[vertices],
            components_m=self.components_m[:, vertices],
            vertex_weights=self.vertex_weights[vertices],
            left_out=self.left_out,
        )


def fit_bases(
    meshes_m: FloatArray, num_bases: int, vertex_weights: FloatArray | None = None
) -> Bases:
    """Find mean and principal components of meshes, without those that are not like the others.

    Args:
        meshes_m: Metres, ``[F, V, 3]``.
        num_bases: Most components; fewer where the meshes have no more.
        vertex_weights: How much an error of each vertex counts, ``[V]``; all alike without.

    Raises:
        CaptureError: Fewer than `LEAST_FRAMES` good meshes, or meshes that do not move.
    """
    num_vertices = meshes_m.shape[1]
    weights = np.ones(num_vertices) if vertex_weights is None else vertex_weights
    frames = np.unique(np.linspace(0, len(meshes_m) - 1, MOST_FRAMES).round().astype(int))
    good = frames[np.isfinite(meshes_m[frames]).all((1, 2))]
    left_out = sorted(set(frames.tolist()) - set(good.tolist()))
    root = np.sqrt(weights / weights.sum()).astype(np.float32)[:, None]
    while True:
        if len(good) < LEAST_FRAMES:
            raise CaptureError(
                f"{len(good)} good training meshes ({_named(left_out)}); "
                f"bases need {LEAST_FRAMES}, the variant full needs none"
            )
        # From the median, which no single mesh moves; about the mean, they would be dependent.
        products = _products((meshes_m[good] - np.median(meshes_m[good], axis=0)) * root)
        bad = _jumps(products)
        if not bad:
            break
        left_out = sorted([*left_out, *good[bad].tolist()])
        good = np.delete(good, bad)
    products -= products.mean(0)
    products -= products.mean(1, keepdims=True)
    spread, vectors = np.linalg.eigh(products)
    order = np.argsort(spread)[::-1][:num_bases]
    least = max(float(spread.max()) * LEAST_SHARE, LEAST_M**2 * len(good))
    order = order[spread[order] > least]
    if not len(order):
        raise CaptureError("the training meshes are all alike; there is no movement to learn")
    mean_m = meshes_m[good].mean(0, dtype=np.float64).astype(np.float32)
    offsets = meshes_m[good] - mean_m
    # Rows are the good meshes; a component is what goes with a unit of its weight.
    unit = vectors[:, order] * np.sqrt(len(good))
    components_m = (unit.T / len(good)).astype(np.float32) @ offsets.reshape(len(good), -1)
    return Bases(
        mean_m=mean_m,
        components_m=components_m.reshape(len(order), num_vertices, 3),
        vertex_weights=np.asarray(weights, np.float32),
        left_out=tuple(left_out),
    )


def _products(offsets: FloatArray) -> Float64Array:
    """Inner products of meshes ``[F, V, 3]`` in float64, a part of the vertices after another."""
    total = np.zeros((len(offsets), len(offsets)))
    for start in range(0, offsets.shape[1], 2048):
        part = offsets[:, start : start + 2048].reshape(len(offsets), -1).astype(np.float64)
        total += part @ part.T
    return total


def _jumps(products: Float64Array) -> list[int]:
    """Places of meshes that the others do not explain: the square of a mesh's distance from what
    the others span is one over its entry in the inverse of their inner products."""
    spread, vectors = np.linalg.eigh(products)
    noise = max(float(spread.max()), 1e-18) * 1e-9
    inverse = (vectors**2 / (np.maximum(spread, 0) + noise)).sum(1)
    off_m = np.sqrt(np.maximum(1 / inverse - noise, 0))
    limit_m = max(JUMP_M, JUMP_RATIO * float(np.median(off_m)))
    bad: list[int] = np.flatnonzero(off_m > limit_m).tolist()
    return bad if len(bad) <= len(off_m) // 4 else []


def _named(frames: list[int]) -> str:
    shown = ", ".join(map(str, frames[:8])) + (", ..." if len(frames) > 8 else "")
    return f"left out: {shown}" if frames else "none left out"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SplitBases:
    """Bases by regions, as `pica_core.avatar.linear` stores them."""

    order: IntArray
    """Vertex at each place of the sheet, ``[V]``."""
    mean_m: FloatArray
    """Sheet ``[R, REGION, 3]``; places behind the last vertex repeat it."""
    rank: IntArray
    """Directions of each region, falling, ``[R]``."""
    basis: FloatArray
    """Their offsets, region after region, 1 the largest of each, ``[L, REGION, 3]``."""
    mix_m: FloatArray
    """What the weights of the whole are to each direction, metres, ``[L, K]``."""


def split_bases(bases: Bases, vertex_uv: FloatArray) -> SplitBases:
    """Cut bases along the chart, prune each region, and round to what a file holds.

    Args:
        vertex_uv: Where vertices lie in the chart, ``[V, 2]``.
    """
    count = len(bases.components_m)
    regions = _cut(vertex_uv, np.arange(len(vertex_uv), dtype=np.int32))
    found = []
    for vertices in regions:
        part = bases.components_m[:, vertices].astype(np.float64).reshape(count, -1)
        square, left = np.linalg.eigh(part @ part.T)
        lost_m = np.sqrt(np.cumsum(square.clip(0)) / len(vertices))
        left = left[:, lost_m > TOLERANCE_M][:, ::-1]
        offsets = left.T @ part
        reach_m = np.abs(offsets).max(1, initial=0, keepdims=True)
        found.append((left.shape[1], vertices, left.T * reach_m, offsets / reach_m))
    # By falling rank, so that regions of one rank are neighbours; a short one comes last.
    found.sort(key=lambda region: (len(region[1]) < REGION, -region[0]))
    basis = np.zeros((sum(rank for rank, *_ in found), REGION, 3), np.float32)
    mean_m = np.zeros((len(found), REGION, 3), np.float32)
    at = 0
    for row, (rank, vertices, _, offsets) in enumerate(found):
        basis[at : at + rank, : len(vertices)] = offsets.reshape(rank, len(vertices), 3)
        mean_m[row] = bases.mean_m[np.resize(vertices, REGION)]
        at += rank
    return SplitBases(
        order=np.concatenate([vertices for _, vertices, *_ in found]),
        mean_m=mean_m,
        rank=np.array([rank for rank, *_ in found], np.int32),
        basis=round_signed(basis),
        mix_m=np.concatenate([mix_m for _, _, mix_m, _ in found]).astype(np.float32),
    )


def unexplained_m(
    meshes_m: FloatArray, num_bases: int, vertex_weights: FloatArray, vertex_uv: FloatArray
) -> float:
    """What bases of three in four meshes leave of every fourth: the root mean square error of the
    worst region, metres. 0 with fewer than two meshes for each basis: bending cannot be told from
    a lack of meshes then.

    Args:
        meshes_m: Good ones, ``[F, V, 3]``; the others as for `fit_bases` and `split_bases`.
    """
    if len(meshes_m) < 2 * num_bases:
        return 0.0
    apart = np.arange(len(meshes_m)) % 4 == 3
    bases = fit_bases(meshes_m[~apart], num_bases, vertex_weights)
    meshes_m = meshes_m[apart]
    weights, worst = bases.weights_of(meshes_m), 0.0
    for vertices in _cut(vertex_uv, np.arange(len(vertex_uv), dtype=np.int32)):
        left = meshes_m[:, vertices] - bases.select(vertices).positions(weights)
        worst = max(worst, float(np.square(left).sum(2).mean()))
    return float(np.sqrt(worst))


def _cut(vertex_uv: FloatArray, vertices: IntArray) -> list[IntArray]:
    """Halves of halves along the longer side of the chart, of `REGION` vertices each but one."""
    if len(vertices) <= REGION:
        return [vertices]
    uv = vertex_uv[vertices]
    ordered = vertices[np.argsort(uv[:, int(np.ptp(uv, axis=0).argmax())], kind="stable")]
    half = -(-len(vertices) // REGION) // 2 * REGION
    return _cut(vertex_uv, ordered[:half]) + _cut(vertex_uv, ordered[half:])
