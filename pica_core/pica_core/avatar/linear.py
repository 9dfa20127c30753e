"""Geometry as a linear function of the latent: names, shapes and checks of its tensors.

An avatar whose spec says `bases` has no position map. Its vertices lie in a sheet, `REGION` to a
row: vertex number k stands in row k // REGION and column k % REGION. Each row is a region of the
chart with as many directions of its own as its movement needs:

    w         = linear.weight . latent + linear.bias              K weights of the whole
    local     = linear.mix . w                                    L weights, region after region
    sheet[r]  = linear.mean[r] + scale * (its local . its rows of linear.basis)

Scale is the manifest's `position_scale_m`. Float32 in memory unless stated:

    linear.weight [K, 256]   linear.bias [K]   linear.mix [L, K]
    linear.basis  [L, REGION, 3]               1 is the farthest that a direction moves; 8 bits
    linear.mean   [R, REGION, 3] metres        16 bits
    linear.rank   [R] int32                    directions of each region, L in all

The directions are a closed form: the principal components of training meshes.

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

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pica_core.avatar.spec import MAP_SIZE, POSITION_CHANNELS
from pica_core.errors import CaptureError
from pica_core.types import NUM_LATENT, Array, Float64Array, FloatArray, IntArray

PREFIX = "linear."
REGION = MAP_SIZE
"""Vertices of a region, a row of the sheet."""
RANK = PREFIX + "rank"
MAX_BASES = 128
MAX_COMPONENTS = 4_000_000
"""Vertices times bases (chosen: four times what the shipped heads have; 48 MB in memory)."""
MAX_DIRECTIONS = 8192
"""Directions of all regions (chosen: seven times what the shipped heads have; 6 MB in a file)."""


def linear_shapes(
    shapes: Mapping[str, tuple[int, ...]], num_vertices: int
) -> dict[str, tuple[int, ...]]:
    """Shapes that the ``linear.*`` tensors of a file must have, by those that it has; ValueError if
    a number of bases or directions is out of its limits."""
    mix = (*shapes.get(f"{PREFIX}mix", ()), 0, 0)
    for what, count, limit in (("rows", mix[0], MAX_DIRECTIONS), ("columns", mix[1], MAX_BASES)):
        if not 1 <= count <= limit:
            raise ValueError(f"tensor linear.mix has {count} {what}; allowed are 1 to {limit}")
    if (total := num_vertices * mix[1]) > MAX_COMPONENTS:
        raise ValueError(
            f"tensor linear.mix has {mix[1]} columns for {num_vertices} vertices, "
            f"{total} components; at most {MAX_COMPONENTS} are allowed"
        )
    directions, count, rows = mix[0], mix[1], -(-num_vertices // REGION)
    return {
        f"{PREFIX}weight": (count, NUM_LATENT),
        f"{PREFIX}bias": (count,),
        f"{PREFIX}mix": (directions, count),
        f"{PREFIX}basis": (directions, REGION, POSITION_CHANNELS),
        f"{PREFIX}mean": (rows, REGION, POSITION_CHANNELS),
        RANK: (rows,),
    }


def check_linear(tensors: Mapping[str, Array]) -> None:
    """Raise a ValueError for a rank below 0 or above the number of weights, or if ranks do not add
    up to the directions; names and shapes fit already."""
    rank, (directions, count) = tensors[RANK], tensors[f"{PREFIX}mix"].shape
    if rank.min() < 0 or rank.max() > count:
        raise ValueError(
            f"tensor {RANK} has ranks {rank.min()} to {rank.max()}; allowed are 0 to {count}"
        )
    if (total := int(rank.sum(dtype=np.int64))) != directions:
        raise ValueError(f"tensor {RANK} adds up to {total}; linear.mix has {directions} rows")


def weights_of_latent(tensors: Mapping[str, Array], latent: Array) -> Array:
    """Latents ``[..., 8, 8, 4]`` to the weights of the whole ``[..., K]``, float64."""
    flat = np.asarray(latent, np.float64).reshape(*latent.shape[:-3], NUM_LATENT)
    found: Array = flat @ tensors[f"{PREFIX}weight"].astype(np.float64).T
    return found + tensors[f"{PREFIX}bias"]


def components_of(
    tensors: Mapping[str, Array], scale_m: float, vertices: IntArray | None = None
) -> FloatArray:
    """What a unit of each weight moves, regions put together again, metres: float32 ``[K, V, 3]``
    of the vertices with these numbers, or of all places of the sheet."""
    mix_m = scale_m * tensors[f"{PREFIX}mix"]
    if vertices is None:
        chosen = _movements(tensors, mix_m)
    else:
        chosen = np.empty((len(vertices), POSITION_CHANNELS, mix_m.shape[1]), np.float32)
        basis, regions = tensors[f"{PREFIX}basis"], vertices // REGION
        for region, part in enumerate(_parts(tensors)):
            here = np.flatnonzero(regions == region)
            moved = basis[part][:, vertices[here] % REGION]
            chosen[here] = np.tensordot(moved, mix_m[part], axes=(0, 0))
    return np.ascontiguousarray(chosen.transpose(2, 0, 1), np.float32)


def _parts(tensors: Mapping[str, Array]) -> list[slice]:
    """The directions of each region."""
    ends = np.cumsum(tensors[RANK]).tolist()
    return [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]


def _movements(tensors: Mapping[str, Array], mix_m: Array) -> FloatArray:
    """What a unit of each column of a mix ``[L, C]`` moves each place: ``[R * REGION, 3, C]``."""
    basis, parts = tensors[f"{PREFIX}basis"], _parts(tensors)
    whole = np.zeros((len(parts), REGION, POSITION_CHANNELS, mix_m.shape[1]), np.float32)
    for row, part in enumerate(parts):
        whole[row] = np.tensordot(basis[part], mix_m[part], axes=(0, 0))
    return whole.reshape(-1, POSITION_CHANNELS, mix_m.shape[1])


def latent_movements(tensors: Mapping[str, Array], scale_m: float) -> FloatArray:
    """Rows of places, metres, float32 ``[R * REGION, C]``: no latent of length 1 moves two places
    apart by more than their rows are apart."""
    parts = tensors[f"{PREFIX}weight"], tensors[f"{PREFIX}bias"][:, None]
    # As large as weights for the same latent, and no larger than it is wide.
    root = np.asarray(np.linalg.qr(np.concatenate(parts, axis=1).T, mode="r"))
    moved = _movements(tensors, scale_m * tensors[f"{PREFIX}mix"] @ root.T)
    return moved.reshape(len(moved), -1)


def stretches(moved: FloatArray, faces: IntArray) -> FloatArray:
    """How far the ends of two sides of each triangle ``[F, 3]`` are apart in such rows ``[2, F]``:
    no latent of length 1 makes a side longer by more."""
    apart = []
    for some in np.array_split(faces, -(-len(faces) // 8192)):  # a few megabytes at a time
        a, b, c = moved[some].transpose(1, 0, 2)
        apart.append([np.linalg.norm(end - a, axis=1) for end in (b, c)])
    return np.concatenate(apart, axis=1)


TOLERANCE_M = 1e-5
"""Root mean square distance that a region may lose by its pruning (chosen: a tenth of what vertices
may err; `docs/training.md`)."""
SIGNED_STEP = float(np.float32(1 / 127))
"""Step of "s8": values from -1 to 1 in 8 bits, 0 exactly."""
LEAST_FRAMES = 8
"""Fewer meshes make no bases."""
MOST_FRAMES = 1024
"""Meshes that the components are found from; of more, evenly spaced ones."""
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
        )


def fit_bases(
    meshes_m: FloatArray, num_bases: int, vertex_weights: FloatArray | None = None
) -> Bases:
    """Find mean and principal components of meshes.

    Args:
        meshes_m: Metres, ``[F, V, 3]``.
        num_bases: Most components; fewer where the meshes have no more.
        vertex_weights: How much an error of each vertex counts, ``[V]``; all alike without.

    Raises:
        CaptureError: Fewer than `LEAST_FRAMES` meshes, or meshes that do not move.
    """
    if len(meshes_m) < LEAST_FRAMES:
        raise CaptureError(
            f"{len(meshes_m)} training meshes; bases need {LEAST_FRAMES}, "
            "the variant full needs none"
        )
    num_vertices = meshes_m.shape[1]
    weights = np.ones(num_vertices) if vertex_weights is None else vertex_weights
    some = np.unique(np.linspace(0, len(meshes_m) - 1, MOST_FRAMES).round().astype(int))
    meshes_m = meshes_m[some]
    root = np.sqrt(weights / weights.sum()).astype(np.float32)[:, None]
    products = _products((meshes_m - np.median(meshes_m, axis=0)) * root)
    products -= products.mean(0)
    products -= products.mean(1, keepdims=True)
    spread, vectors = np.linalg.eigh(products)
    order = np.argsort(spread)[::-1][:num_bases]
    least = max(float(spread.max()) * LEAST_SHARE, LEAST_M**2 * len(meshes_m))
    order = order[spread[order] > least]
    if not len(order):
        raise CaptureError("the training meshes are all alike; there is no movement to learn")
    mean_m = meshes_m.mean(0, dtype=np.float64).astype(np.float32)
    offsets = (meshes_m - mean_m).reshape(len(meshes_m), -1)
    # Rows are the meshes; a component is what goes with a unit of its weight.
    unit = vectors[:, order] * np.sqrt(len(meshes_m))
    components_m = (unit.T / len(meshes_m)).astype(np.float32) @ offsets
    return Bases(
        mean_m=mean_m,
        components_m=components_m.reshape(len(order), num_vertices, 3),
        vertex_weights=np.asarray(weights, np.float32),
    )


def _products(offsets: FloatArray) -> Float64Array:
    """Inner products of meshes ``[F, V, 3]`` in float64, a part of the vertices after another."""
    total = np.zeros((len(offsets), len(offsets)))
    for start in range(0, offsets.shape[1], 2048):
        part = offsets[:, start : start + 2048].reshape(len(offsets), -1).astype(np.float64)
        total += part @ part.T
    return total


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


def _cut(vertex_uv: FloatArray, vertices: IntArray) -> list[IntArray]:
    """Halves of halves along the longer side of the chart, of `REGION` vertices each but one."""
    if len(vertices) <= REGION:
        return [vertices]
    uv = vertex_uv[vertices]
    ordered = vertices[np.argsort(uv[:, int(np.ptp(uv, axis=0).argmax())], kind="stable")]
    half = -(-len(vertices) // REGION) // 2 * REGION
    return _cut(vertex_uv, ordered[:half]) + _cut(vertex_uv, ordered[half:])


def signed_codes(array: Array) -> Array:
    """Values from -1 to 1 as bytes 1 to 255, 0 as 128."""
    return (np.rint(array * np.float32(127)) + 128).clip(1, 255).astype(np.uint8)


def round_signed(array: Array) -> Array:
    """Values from -1 to 1 as "s8" gives them back."""
    step = np.float32(SIGNED_STEP)
    return -128 * step + step * signed_codes(array).astype(np.float32)
