"""The pixels that a step looks at: which ones, what lies under them, what the capture shows there.

The driver says once a step which triangle covers which pixel. From then on everything is a list of
P pixels of all images together, on the device of the meshes.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pica_core.camera import Camera
from pica_core.capture.dataset.dataset import Topology
from pica_core.model.interface import Surface
from pica_core.train.losses import screen_normals
from pica_core.train.rasterise import Rasteriser, Views, hit_points
from pica_core.types import FloatArray, Int64Array, IntArray

NORMAL_SHARE = 4
"""Where pixels are drawn, every fourth has a normal: it needs the depth of two neighbours."""


class PixelList(NamedTuple):
    """P pixels of N images, sorted.

    Attributes:
        image: int64 ``[P]``.
        pixel: Flat index within the image, int64 ``[P]``.
    """

    image: Int64Array
    pixel: Int64Array


class DrawnPixels(NamedTuple):
    """What interpolation finds at the pixels of a step.

    Attributes:
        ids: The triangle of every pixel of N images, -1 where none, int32 ``[N, H, W]``.
        depth_pixels: Those whose depth is asked for: the same and, with normals, neighbours.
        depth_m: Their depths; differentiable, ``[Q]``.
        depth_image: Which image they are of, int64 ``[Q]``.
        rays: Their directions, z = 1, ``[Q, 3]``.
        centre: Indices into these Q of pixels with both neighbours, int64 ``[R]``.
        right: Of their right neighbours.
        below: Of the neighbours below.
    """

    ids: IntArray
    pixels: PixelList
    surface: Surface
    depth_pixels: PixelList
    depth_m: Tensor
    depth_image: Tensor
    rays: Tensor
    centre: Tensor
    right: Tensor
    below: Tensor

    def normals(self, depth_m: Tensor) -> Tensor:
        """Screen-space normals at `centre` of depths ``[Q]``: the mesh's or the capture's."""
        corners = [
            self.rays[places] * depth_m.index_select(0, places)[:, None]
            for places in (self.centre, self.right, self.below)
        ]
        return screen_normals(*corners)


class MeshDrawer:
    """Draws the meshes of one topology.

    Args:
        rasteriser: Made for that topology; it stays its owner's.
        face_weights: How much more often than others a pixel of each triangle is drawn, ``[F]``;
            all alike without.
    """

    def __init__(
        self,
        rasteriser: Rasteriser,
        topology: Topology,
        face_weights: FloatArray | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        self.rasteriser = rasteriser
        faces = topology.faces.astype(np.int64)
        self._faces = torch.from_numpy(faces).to(device)
        self._face_uv = torch.from_numpy(np.float32(topology.vertex_uv[faces])).to(device)
        self._face_weights = np.ones(len(faces), np.float32)
        if face_weights is not None:
            self._face_weights = face_weights.astype(np.float32)

    def draw(
        self,
        vertices_m: Tensor,
        cameras: list[Camera],
        rngs: list[np.random.Generator] | None = None,
        *,
        pixels_per_image: int = 0,
        normals: bool = False,
    ) -> DrawnPixels:
        """Find the triangle of every pixel of N images, draw covered ones, and interpolate there.

        Args:
            vertices_m: ``[N, V, 3]``; gradients flow there.
            rngs: Choose among the pixels of each image; without, all are drawn.
            pixels_per_image: About how many; 0 for all.
        """
        meshes = vertices_m.detach().to("cpu", torch.float32).numpy()
        ids = self.rasteriser.batch_ids(meshes, cameras)
        size, width = ids[0].size, cameras[0].width
        choices: Sequence[np.random.Generator | None] = rngs or [None] * len(ids)
        parts = [
            index * size + self._choose(own.reshape(-1), rng, pixels_per_image)
            for index, (own, rng) in enumerate(zip(ids, choices, strict=True))
        ]
        wanted = chosen = np.concatenate(parts)
        if normals:
            every = 1 if pixels_per_image == 0 else NORMAL_SHARE
            centre = _with_neighbours(ids, np.concatenate([part[::every] for part in parts]))
            mark = np.zeros(ids.size, bool)
            for places in (chosen, centre + 1, centre + width):
                mark[places] = True
            wanted = np.flatnonzero(mark)
            place = np.cumsum(mark) - 1
        views, listed = Views.of(cameras, vertices_m), PixelList(*np.divmod(wanted, size))
        triangle = ids.reshape(-1)[wanted].astype(np.int64)
        image, pixel, triangles = (
            torch.from_numpy(values).to(vertices_m.device) for values in (*listed, triangle)
        )
        hits = hit_points(views.see(vertices_m), self._faces, views, image, pixel, triangles)
        points, at = [*hits, triangles], [image[:0]] * 3
        if normals:
            own, *at = (
                torch.from_numpy(place[places]).to(image.device)
                for places in (chosen, centre, centre + 1, centre + width)
            )
            points = [values.index_select(0, own) for values in points]
        image, weights, depth_m, rays, triangles = points
        uv = (weights[:, :, None] * self._face_uv.index_select(0, triangles)).sum(1)
        surface = Surface(image, uv, views.to_head(image, rays * depth_m[:, None]))
        pixels = PixelList(*np.divmod(chosen, size))
        return DrawnPixels(ids, pixels, surface, listed, hits.depth_m, hits.image, hits.rays, *at)

    def _choose(self, ids: IntArray, rng: np.random.Generator | None, wanted: int) -> Int64Array:
        """Covered pixels of an image, each with its chance, so that about `wanted` come."""
        covered: Int64Array = np.flatnonzero(ids >= 0)
        if rng is None or wanted == 0 or len(covered) <= wanted:
            return covered
        weights = self._face_weights[ids[covered]]
        drawn = rng.random(len(covered), np.float32) * np.float32(weights.sum() / wanted) < weights
        chosen: Int64Array = covered[drawn]
        return chosen


def _with_neighbours(ids: IntArray, places: Int64Array) -> Int64Array:
    """Those of some covered pixels whose right and lower neighbours are covered, too."""
    covered = ids >= 0
    both = np.zeros_like(covered)
    both[:, :-1, :-1] = covered[:, :-1, 1:] & covered[:, 1:, :-1]
    kept: Int64Array = places[both.reshape(-1)[places]]
    return kept
