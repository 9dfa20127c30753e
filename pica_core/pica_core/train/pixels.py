"""The pixels that a step looks at: chosen, and met on their triangles, all in torch.

A rasteriser answers the discrete question (which triangle covers this pixel centre?) and this the
smooth one (where on that triangle?), so gradients reach the vertices through the interpolation
weights. They are those of the ray through the pixel centre. With the triangle's corners p0, p1, p2
in camera axes and the ray d, the hit point is w0 p0 + w1 p1 + w2 p2 with

    w0 : w1 : w2  =  d . (p1 x p2)  :  d . (p2 x p0)  :  d . (p0 x p1)

which is perspective-correct by construction and needs no division but the last. What a corner has
along d does not change the volumes, so they are made of what it lies beside the ray: small numbers,
whose differences keep their digits. Coverage itself has no gradient.

Every image of a batch has the same number K of pixels, so that shapes can stay fixed; those of
images that have fewer are filled up.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pica_core.capture.dataset.files import Topology
from pica_core.model.interface import Surface
from pica_core.train.losses import screen_normals
from pica_core.train.raster import Capacity, Rasteriser, Views
from pica_core.types import FloatArray

PIXEL_MARGIN = 1.1
"""Of `MeshDrawer.capacity`."""
EDGE_ON = 0.5
"""A pixel in a triangle has volumes of one sign, so their sum is the sum of their sizes. Where
rounding leaves no more than this part of it, the triangle is seen edge-on."""


def hit_points(
    seen_m: Tensor, faces: Tensor, triangles: Tensor, rays: Tensor
) -> tuple[Tensor, Tensor]:
    """Where rays meet their triangles.

    Args:
        seen_m: Meshes in camera axes (`Views.see`), metres, ``[N, V, 3]``; gradients flow there.
        faces: int64 ``[F, 3]``.
        triangles: Of each pixel, ``[N, K]``.
        rays: Through the pixels, ``[N, K, 3]``.

    Returns:
        Weights of the triangles' corners, summing to 1, ``[N, K, 3]``, and depths along the
        camera's axis, metres, ``[N, K]``; both differentiable.
    """
    count, vertices = seen_m.shape[:2]
    offset = vertices * torch.arange(count, device=seen_m.device)[:, None, None]
    corners = faces.index_select(0, triangles.view(-1)).view(*triangles.shape, 3) + offset
    points = seen_m.reshape(-1, 3).index_select(0, corners.view(-1)).view(-1, 3, 3)
    weights, depth_m = interpolation_weights(points, rays.reshape(-1, 3))
    return weights.view(rays.shape), depth_m.view(triangles.shape)


def interpolation_weights(corners: Tensor, rays: Tensor) -> tuple[Tensor, Tensor]:
    """Perspective-correct weights of the point where each ray meets its triangle's plane.

    Args:
        corners: Triangle corners in camera axes, metres, ``[P, 3 corners, 3]``.
        rays: Ray directions in camera axes with z = 1, ``[P, 3]``.

    Returns:
        Weights summing to 1, ``[P, 3]``, and depth along z in metres, ``[P]``. Differentiable in
        `corners`.

    A triangle of no area, or seen edge-on as far as 32 bits can tell, has no answer. GL, which
    rounds otherwise, draws a pixel of one now and then: it gets the triangle's middle. Corners that
    are no numbers get the same weights, for torch's lookups crash at NaN.
    """
    # Coordinates by corner as rows of P: half of the time of P small matrices, on a CPU.
    x, y, depths = corners.permute(2, 1, 0).contiguous()
    x, y = x - depths * rays[:, 0], y - depths * rays[:, 1]
    turns = ((1, 2), (2, 0), (0, 1))
    volumes = torch.stack([x[i] * y[j] - x[j] * y[i] for i, j in turns])
    total = volumes.sum(0)
    # Within a triangle volumes have one sign; on its border rounding may turn a small one.
    is_sound = total.detach().abs() > EDGE_ON * volumes.detach().abs().sum(0)
    weights = torch.where(is_sound, volumes / torch.where(is_sound, total, 1.0), 1 / 3)
    return weights.T, (weights * depths).sum(0)


class DrawnPixels(NamedTuple):
    """What interpolation finds at K pixels of each of N images.

    Attributes:
        pixels: Flat indices within their image, ascending, int64 ``[N, K]``.
        is_drawn: False of those that only fill up, bool ``[N, K]``.
        surface: Where on the surface they lie; differentiable.
        depth_m: Their depths, metres; differentiable, ``[N, K]``.
        rays: Their directions, z = 1, ``[N, K, 3]``.
        views: The cameras.
    """

    pixels: Tensor
    is_drawn: Tensor
    surface: Surface
    depth_m: Tensor
    rays: Tensor
    views: Views

    def of(self, images: Tensor) -> Tensor:
        """What images ``[N, H, W, ...]`` hold at the pixels, ``[N, K, ...]``."""
        count, height, width, *rest = images.shape
        offset = height * width * torch.arange(count, device=images.device)[:, None]
        found = images.reshape(-1, *rest).index_select(0, (self.pixels + offset).view(-1))
        return found.view(*self.pixels.shape, *rest)

    def beside(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """What the right neighbours and those below have of ``[N, K]``: 0 where they are not among
        the pixels."""
        width, size = self.views.width, self.views.width * self.views.height
        # One more place, for what lies beside the image.
        image = values.new_zeros(len(values), size + 1)
        image = image.scatter(1, torch.where(self.is_drawn, self.pixels, size), values)
        image = torch.cat([image[:, :size], torch.zeros_like(image[:, size:])], 1)
        is_last = self.pixels % width == width - 1
        right = torch.where(is_last, size, self.pixels + 1).clamp_max(size)
        return image.gather(1, right), image.gather(1, (self.pixels + width).clamp_max(size))

    def normals(self, depth_m: Tensor) -> Tensor:
        """Screen-space normals of depths ``[N, K]``, the mesh's or the capture's, ``[N, K, 3]``;
        they mean something where both neighbours have a depth, too."""
        right_m, below_m = self.beside(depth_m)
        along_x, along_y, _ = self.views.inverse[:, None].unbind(3)
        corners = [
            self.rays * depth_m[:, :, None],
            (self.rays + along_x) * right_m[:, :, None],
            (self.rays + along_y) * below_m[:, :, None],
        ]
        return screen_normals(*corners)


class MeshDrawer:
    """Draws the meshes of one topology.

    Args:
        rasteriser: Made for that topology; it stays its owner's.
        face_weights: How much more often than others a pixel of each triangle is drawn, ``[F]``;
            all alike without.

    Attributes:
        capacity: Of an image's list of pixels.
    """

    def __init__(
        self,
        rasteriser: Rasteriser,
        topology: Topology,
        face_weights: FloatArray | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        self.rasteriser = rasteriser
        self.capacity = Capacity(PIXEL_MARGIN)
        faces = topology.faces.astype(np.int64)
        self._faces = torch.from_numpy(faces).to(device)
        self._face_uv = torch.from_numpy(np.float32(topology.vertex_uv[faces])).to(device)
        if face_weights is None:
            face_weights = np.ones(len(faces), np.float32)
        weights = np.append(np.float32(0), face_weights.astype(np.float32))  # 0: no triangle
        self._weights = torch.from_numpy(weights).to(device)
        self._chances = torch.zeros(0)

    def draw(
        self, vertices_m: Tensor, views: Views, *, count: int = 0, shift: Tensor | None = None
    ) -> DrawnPixels:
        """Find the triangle of every pixel of N images, choose some, and interpolate there.

        Args:
            vertices_m: ``[N, V, 3]``; gradients flow there.
            count: About how many covered pixels of each image are chosen; 0 for all.
            shift: Random numbers from 0 to H W that choose them, int64 ``[N]``.
        """
        ids = self.rasteriser.triangles(vertices_m, views)
        is_chosen = ids >= 0 if shift is None else self._choose(ids, count, shift)
        pixels, is_drawn = self._listed(is_chosen)
        triangles = ids.gather(1, pixels).clamp_min(0).to(torch.int64)
        rays = views.rays(pixels)
        weights, depth_m = hit_points(views.see(vertices_m), self._faces, triangles, rays)
        corner_uv = self._face_uv.index_select(0, triangles.view(-1)).view(*triangles.shape, 3, 2)
        uv = (weights[:, :, :, None] * corner_uv).sum(2)
        surface = Surface(uv, views.to_head(rays * depth_m[:, :, None]))
        return DrawnPixels(pixels, is_drawn, surface, depth_m, rays, views)

    def _choose(self, ids: Tensor, count: int, shift: Tensor) -> Tensor:
        """Choose covered pixels, each with its chance, so that about `count` of an image come."""
        size = ids.shape[1]
        if len(self._chances) != 2 * size:
            chances = torch.rand(size, generator=torch.Generator().manual_seed(0))
            self._chances = torch.cat([chances, chances]).to(ids.device)
        weights = self._weights.index_select(0, ids.view(-1) + 1).view(ids.shape)
        chances = self._chances.unfold(0, size, 1).index_select(0, shift)
        return chances * (weights.sum(1, keepdim=True) / count) < weights

    def _listed(self, is_chosen: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels, filled up to the most that an image has, and which of them are no filling."""
        images, size = is_chosen.shape
        sums = is_chosen.view(-1).cumsum(0, dtype=torch.int32)
        ends = sums[size - 1 :: size]
        before = (ends - is_chosen.sum(1, dtype=torch.int32))[:, None]
        count = max(1, min(self.capacity.of((ends[:, None] - before).max()), size))
        wanted = before + torch.arange(1, count + 1, dtype=torch.int32, device=ends.device)
        first = size * torch.arange(images, device=ends.device)[:, None]
        pixels = (torch.searchsorted(sums, wanted) - first).clamp_max(size - 1)
        return pixels, wanted <= ends[:, None]
