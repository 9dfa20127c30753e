"""Early exits, fitted by least squares with the trunk as it is.

An exit is one linear layer and a map-sized bias behind a trunk that is not touched, so what it
makes is linear in what is fitted, and the best exit is the solution of a system of equations:
seconds, no learning rate, no seed but that of the faces it is fitted on.

At points of the surface, codes of the small map and of a still full one together give the colours
of the full one: differences of codes are weighed by the pixel decoder's own slope there. The map is
only ever read at points inside charts; texels that no point reads keep an average of the full map.
So a texel that two charts share is fitted to both. What one convolution leaves, blocks of texels
learn with weights of their own, on the coarsest level (`fit_local`).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.sparse import csr_array, eye_array
from scipy.sparse.linalg import cg
from torch import Tensor
from torch.nn import functional

from pica_core.avatar.file import Avatar
from pica_core.avatar.levels import LOCAL_TEXELS
from pica_core.avatar.spec import EXPRESSION_CHANNELS, trunk_layers
from pica_core.model.networks import MapDecoder, sample_map, tile_view_direction
from pica_core.reference import decode_pixels
from pica_core.sampling import neighbours
from pica_core.types import Float64Array

CHUNK = 8
"""Faces decoded at once."""
RIDGE = 1e-6
"""Added to the diagonal of a system, as a share of its mean: keeps idle features quiet."""
BLOCK_RIDGE = 1e-3
"""The same for the weights of a block of texels (1e-2 leaves 4 % more on one head)."""
POINTS_PER_FACE = 1000
"""Points that are read in each face while a convolution is fitted."""
PRIOR = 1e-3
"""Weight of the start in a map, where a point's weight is 1."""
MAP_STEPS = 100
"""Steps of conjugate gradients for a map; 200 more change its mean misfit by less than a percent,
where points are many times the texels."""
METRIC_FLOOR = 0.02
"""Least weight of a direction of codes, as a share of the mean over directions and points."""
CODE_STEP = 0.02
"""Half of the step over which the pixel decoder's slope is taken, in units of a code."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceSet:
    """Faces that exits are fitted on, and from where they are seen."""

    latents: Tensor
    """``[N, 4, 8, 8]``."""
    views: Tensor
    """Unit vectors, ``[N, 3]``."""

    def __len__(self) -> int:
        return len(self.latents)


class FrozenDecoder:
    """The expression decoder of an avatar, rebuilt from its file: full maps and what exits find."""

    def __init__(self, avatar: Avatar) -> None:
        self._spec = avatar.spec
        self._module = MapDecoder(avatar.spec, "expression")
        with torch.no_grad():
            for name, values in self._module.named_tensors().items():
                values.copy_(torch.from_numpy(np.array(avatar.tensors[name])))

    @torch.no_grad()
    def run(self, faces: FaceSet, level: int) -> Iterator[tuple[Tensor, Tensor]]:
        """Trunk ``[n, C, level, level]`` and decoder's output ``[n, C', S, S]``, chunk by chunk."""
        end = len(trunk_layers(self._spec, level))
        for start in range(0, len(faces), CHUNK):
            latent, view = (v[start : start + CHUNK] for v in (faces.latents, faces.views))
            grid = torch.cat([latent, tile_view_direction(view)], 1)
            for step in self._module.steps[:end]:
                grid = step(grid)
            trunk = grid
            for step in self._module.steps[end:]:
                grid = step(grid)
            yield trunk, grid


@dataclass(frozen=True, slots=True, eq=False)
class MapExit:
    """A fitted convolution, a bias, and what each block of texels adds.

    Attributes:
        weight: ``[C', C, 3, 3]``.
        bias: ``[C', level, level]``.
        local: ``[level / 2, level / 2, C', C]``; None where the convolution is all.
    """

    weight: Tensor
    bias: Tensor
    local: Tensor | None = None

    def __call__(self, trunk: Tensor) -> Tensor:
        """Maps ``[N, C', level, level]`` from trunks ``[N, C, level, level]``."""
        maps = functional.conv2d(trunk, self.weight, padding=1) + self.bias
        return maps if self.local is None else maps + _weighed(self.local, trunk)


def fit_convolution(
    decoder: FrozenDecoder,
    faces: FaceSet,
    level: int,
    points: Tensor,
    metric: Tensor,
    bias_points: Tensor,
    still: Tensor,
) -> MapExit:
    """Fit one convolution for all texels, so that its map is like the decoder's own output.

    Args:
        decoder: Whose output to imitate, and whose trunk to do it from.
        level: Rows of the exit's map.
        points: Where maps are read while the convolution is fitted, UV in [0, 1]. ``[P, 2]``.
        metric: How differences count, per point, ``[P, C', C']``.
        bias_points: Where they are read while the bias is fitted, ``[B, 2]``: it has as many
            unknowns as texels, and with too few points for each, single texels go wrong.
        still: The map that the exit's is added to, ``[C', S, S]``: what does not move keeps all of
            its detail, and what does is smooth.
    """
    mean_trunk, mean_full = _means(decoder, faces, level)
    inputs, outputs = 9 * len(mean_trunk), len(mean_full)
    gram = torch.zeros(outputs, inputs, outputs, inputs, dtype=torch.float64)
    right = torch.zeros(outputs, inputs, dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    for trunk, full in decoder.run(faces, level):
        for moved, wanted in zip(trunk - mean_trunk, full - mean_full, strict=True):
            chosen = torch.randint(len(points), (POINTS_PER_FACE,), generator=generator)
            read, own = _features(moved[None], points[chosen]), metric[chosen]
            blocks = (own.flatten(1).T[:, None] * read.T) @ read
            gram += blocks.reshape(outputs, outputs, inputs, inputs).transpose(1, 2).double()
            targets = sample_map(wanted[None], points[chosen])[0]
            right += ((own @ targets[:, :, None])[:, :, 0].T @ read).double()
    gram = gram.reshape(outputs * inputs, -1)
    gram.diagonal().add_(RIDGE * gram.diagonal().mean())
    weight = torch.linalg.solve(gram, right.flatten()).reshape(outputs, -1, 3, 3).float()
    at_rest = functional.conv2d(mean_trunk[None], weight, padding=1)[0]
    # The bias takes the exit from what it says of the mean face to the mean of the output.
    moving = (mean_full - still)[None]
    start = functional.adaptive_avg_pool2d(moving, level)[0] - at_rest
    left = sample_map(moving, bias_points)[0] - sample_map(at_rest[None], bias_points)[0]
    return MapExit(weight, fit_map(bias_points, left, start))


def fit_local(decoder: FrozenDecoder, faces: FaceSet, level: int, exit_: MapExit) -> MapExit:
    """Give each block of texels weights of its own for what a convolution leaves of the output.

    One convolution for all texels takes a cheek and a lid for alike. Blocks are fitted one by one,
    and the map of the mean face stays as it is.
    """
    mean_trunk, mean_full = _means(decoder, faces, level)
    inputs, outputs, side = len(mean_trunk), len(mean_full), level // LOCAL_TEXELS
    grams = torch.zeros(side * side, inputs, inputs, dtype=torch.float64)
    rights = torch.zeros(side * side, inputs, outputs, dtype=torch.float64)
    for trunk, full in decoder.run(faces, level):
        wanted = functional.adaptive_avg_pool2d(full - mean_full, level)
        moved = trunk - mean_trunk
        left = wanted - functional.conv2d(moved, exit_.weight, padding=1)
        read, left = _blocks(moved).double(), _blocks(left).double()
        grams += read.transpose(1, 2) @ read
        rights += read.transpose(1, 2) @ left
    floor = BLOCK_RIDGE * grams.diagonal(dim1=1, dim2=2).mean()
    weights = torch.linalg.solve(grams + floor * torch.eye(inputs, dtype=torch.float64), rights)
    local = weights.transpose(1, 2).reshape(side, side, outputs, inputs).float()
    at_rest = _weighed(local, mean_trunk[None])[0]
    return replace(exit_, local=local, bias=exit_.bias - at_rest)


def _blocks(maps: Tensor) -> Tensor:
    """Blocks of texels of all maps, ``[blocks, N * texels, C]``, of ``[N, C, level, level]``."""
    count, channels, level, _ = maps.shape
    side = level // LOCAL_TEXELS
    parts = maps.reshape(count, channels, side, LOCAL_TEXELS, side, LOCAL_TEXELS)
    return parts.permute(2, 4, 0, 3, 5, 1).reshape(side * side, -1, channels)


def _weighed(local: Tensor, trunk: Tensor) -> Tensor:
    """Trunks ``[N, C, S, S]`` weighed by each block's weights, ``[N, C', S, S]``."""
    own = local.repeat_interleave(LOCAL_TEXELS, 0).repeat_interleave(LOCAL_TEXELS, 1)
    return torch.einsum("ncyx,yxdc->ndyx", trunk, own)


def fit_map(points: Tensor, values: Tensor, start: Tensor) -> Tensor:
    """The map, float32 ``[C, S, S]``, whose bilinear lookups at points are nearest to values there.

    Args:
        points: UV in [0, 1], ``[P, 2]``.
        values: ``[P, C]``.
        start: Map to begin with and to keep where no point reads, ``[C, S, S]``.
    """
    size = start.shape[-1]
    (left, right, across), (top, bottom, down) = (
        neighbours(where, size) for where in points.double().numpy().T
    )
    index = np.stack([row * size + column for row in (top, bottom) for column in (left, right)], 1)
    share = np.concatenate([y * x for y in (1 - down, down) for x in (1 - across, across)], 1)
    rows = np.arange(0, index.size + 1, index.shape[1])
    read = csr_array((share.ravel(), index.ravel(), rows), (len(index), size * size))
    normal = read.T @ read + PRIOR * eye_array(size * size)
    found = start.double().flatten(1).numpy()
    missing = values.double().numpy().T - found @ read.T
    steps = [cg(normal, each @ read, rtol=1e-9, maxiter=MAP_STEPS)[0] for each in missing]
    return torch.from_numpy(found + np.stack(steps)).reshape(start.shape).float()


def colour_metric(
    avatar: Avatar, codes: list[Float64Array], xyz_m: Float64Array, points: Float64Array
) -> Float64Array:
    """How squared differences of colour follow from differences of expression codes, at points:
    inner products of the slopes of RGB (1.0 is white), ``[P, 4, 4]``.

    Args:
        codes: Codes at the points in some faces, ``[P, 4]`` each; the metric is their mean.
        xyz_m: Where the points are at rest, ``[P, 3]``.
        points: UV, ``[P, 2]``.
    """
    spec, tensors = avatar.spec, avatar.tensors
    metric = np.zeros((len(points), EXPRESSION_CHANNELS, EXPRESSION_CHANNELS))
    for code in codes:
        slopes = []
        for step in CODE_STEP * np.eye(EXPRESSION_CHANNELS):
            ends = [
                decode_pixels(spec, tensors, code + side * step, xyz_m, points, np.float64)
                for side in (1, -1)
            ]
            slopes.append((ends[0] - ends[1]) / (2 * CODE_STEP))
        jacobian = np.stack(slopes, axis=-1)  # [P, 3, 4]
        metric += np.einsum("pri,prj->pij", jacobian, jacobian) / len(codes)
    floor = METRIC_FLOOR * np.trace(metric, axis1=1, axis2=2).mean() / EXPRESSION_CHANNELS
    metric += floor * np.eye(EXPRESSION_CHANNELS)
    return metric


def _means(decoder: FrozenDecoder, faces: FaceSet, level: int) -> tuple[Tensor, Tensor]:
    """Mean trunk ``[C, level, level]`` and mean output ``[C', S, S]`` over faces."""
    sums = [(trunk.sum(0), full.sum(0)) for trunk, full in decoder.run(faces, level)]
    trunk, full = (sum(parts[1:], parts[0]) for parts in zip(*sums, strict=True))
    return trunk / len(faces), full / len(faces)


def _features(trunk: Tensor, points: Tensor) -> Tensor:
    """What a 3x3 convolution multiplies, looked up at points: ``[P, 9 C]``, kernel innermost."""
    _, channels, rows, columns = trunk.shape
    unfolded = functional.unfold(trunk, 3, padding=1).reshape(1, 9 * channels, rows, columns)
    return sample_map(unfolded, points)[0]
