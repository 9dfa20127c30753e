"""Rasterisation for training: GL finds the triangle of each pixel, torch the point on it.

GL answers the discrete question (which triangle covers this pixel centre?) and torch the smooth
one (where on that triangle?), so the same code runs on any machine with a GL driver, and gradients
reach the vertices through the interpolation weights.

The weights are those of the ray through the pixel centre. With the triangle's corners p0, p1, p2
in camera axes and the ray d, the hit point is w0 p0 + w1 p1 + w2 p2 with

    w0 : w1 : w2  =  d . (p1 x p2)  :  d . (p2 x p0)  :  d . (p0 x p1)

which is perspective-correct by construction and needs no division but the last. What a corner has
along d does not change the volumes, so they are made of what it lies beside the ray: small numbers,
whose differences keep their digits. Coverage itself has no gradient.

Ids come back to the CPU once an image, as GL gives them; everything after is torch and follows the
device of the vertices.

`MeshDrawer` chooses the pixels that a step looks at: from then on everything is a list of P pixels
of all images together, on the device of the meshes.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from typing import NamedTuple, Self

import moderngl
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pica_core.camera import Camera
from pica_core.capture.dataset.dataset import Topology
from pica_core.errors import GraphicsError, ShapeError
from pica_core.gl import create_context, link_program
from pica_core.model.interface import Surface
from pica_core.train.losses import screen_normals
from pica_core.types import FloatArray, Int64Array, IntArray

# Most wheels of torch bring Triton, which has an LLVM of its own. Mesa's software GL has another;
# when that comes first, the process dies as soon as torch's first optimiser imports Triton.
with suppress(ImportError):
    import_module("triton")

_VERTEX = """#version 330 core
uniform mat4 clip_from_head;
in vec3 position_m;
void main() { gl_Position = clip_from_head * vec4(position_m, 1.0); }
"""
_FRAGMENT = """#version 330 core
out float triangle;
void main() { triangle = float(gl_PrimitiveID + 1); }
"""
NEAR_M = 0.02
FAR_M = 20.0
"""Nothing nearer or further is drawn."""
EDGE_ON = 0.5
"""A pixel in a triangle has volumes of one sign, so their sum is the sum of their sizes. Where
rounding leaves no more than this part of it, the triangle is seen edge-on."""


class Rasteriser:
    """One GL context and one mesh topology for a whole run.

    Use as a context manager, from one thread. Buffers are reused; a new image or batch size makes a
    new framebuffer and releases the old one.

    Args:
        faces: Triangles, counter-clockwise seen from outside, int32 ``[F, 3]``; at most 2^24, as
            many as a float32 target tells apart.

    Raises:
        GraphicsError: No GL context.
    """

    def __init__(self, faces: IntArray, num_vertices: int) -> None:
        self.num_vertices = num_vertices
        self._context = create_context()
        self._program = link_program(self._context, vertex=_VERTEX, fragment=_FRAGMENT)
        self._indices = self._context.buffer(np.ascontiguousarray(faces, np.int32).tobytes())
        self._meshes: list[tuple[moderngl.Buffer, moderngl.VertexArray]] = []
        self._target: moderngl.Framebuffer | None = None
        self._context.enable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)

    @classmethod
    def of(cls, topology: Topology) -> Self:
        """A rasteriser of the meshes of a topology."""
        return cls(topology.faces.astype(np.int32), len(topology.vertex_uv))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Give the context back; the rasteriser is useless afterwards."""
        with self._context:
            self._target = None
            self._meshes.clear()
            self._context.gc()
        self._context.release()

    def triangle_ids(self, vertices_m: FloatArray, cameras: Sequence[Camera]) -> IntArray:
        """The triangle that each pixel centre sees of N meshes in head-frame metres, ``[N, V, 3]``,
        each through its camera, all of one image size; -1 where none. int32 ``[N, H, W]``, row 0 on
        top."""
        with self._context:  # another rasteriser of this thread may have been current
            self._draw(vertices_m, cameras)
            assert self._target is not None
            content = self._target.read(components=1, dtype="f4")
        size = len(cameras), cameras[0].height, cameras[0].width
        return np.frombuffer(content, np.float32).reshape(size)[:, ::-1].astype(np.int32) - 1

    def _draw(self, vertices_m: FloatArray, cameras: Sequence[Camera]) -> None:
        width, height = cameras[0].width, cameras[0].height
        if any((camera.width, camera.height) != (width, height) for camera in cameras):
            raise ShapeError("cameras of several image sizes; a batch needs one")
        target = self._framebuffer(width, height * len(cameras))
        target.use()
        target.clear(0.0, 0.0, 0.0, 0.0)
        while len(self._meshes) < len(cameras):
            positions = self._context.buffer(reserve=self.num_vertices * 12, dynamic=True)
            content = [(positions, "3f", "position_m")]
            mesh = self._context.vertex_array(self._program, content, index_buffer=self._indices)
            self._meshes.append((positions, mesh))
        for index, camera in enumerate(cameras):
            positions, vertex_array = self._meshes[index]
            positions.write(np.ascontiguousarray(vertices_m[index], np.float32))
            matrix = camera.clip_from_world(NEAR_M, FAR_M).T
            self._program["clip_from_head"].write(matrix.tobytes())  # type: ignore[union-attr]
            target.viewport = (0, index * height, width, height)
            vertex_array.render()
        target.viewport = (0, 0, width, height * len(cameras))

    def _framebuffer(self, width: int, height: int) -> moderngl.Framebuffer:
        if self._target is None or self._target.size != (width, height):
            largest = self._context.info["GL_MAX_TEXTURE_SIZE"]
            if max(width, height) > largest:
                raise GraphicsError(
                    f"a batch of {width} x {height} pixels; this driver holds {largest} a side: "
                    "make the batch smaller"
                )
            self._target = None
            self._context.gc()
            self._target = self._context.framebuffer(
                color_attachments=[self._context.texture((width, height), 1, dtype="f4")],
                depth_attachment=self._context.depth_renderbuffer((width, height)),
            )
        return self._target


class Views(NamedTuple):
    """N cameras as tensors of one dtype on one device.

    Attributes:
        rotation: Head to camera, ``[N, 3, 3]``.
        translation_m: ``[N, 3]``.
        inverse: Of the intrinsics, ``[N, 3, 3]``.
        width: Image columns, the same for all.
    """

    rotation: Tensor
    translation_m: Tensor
    inverse: Tensor
    width: int

    @classmethod
    def of(cls, cameras: Sequence[Camera], like: Tensor) -> Views:
        """The cameras with dtype and device of `like`."""

        def stack(matrices: Sequence[npt.NDArray[np.floating]]) -> Tensor:
            return torch.from_numpy(np.stack(matrices)).to(like)

        return cls(
            stack([camera.rotation for camera in cameras]),
            stack([camera.translation_m for camera in cameras]),
            stack([np.linalg.inv(camera.intrinsics) for camera in cameras]),
            cameras[0].width,
        )

    def see(self, vertices_m: Tensor) -> Tensor:
        """Head-frame meshes in their cameras' axes; metres ``[N, V, 3]`` both."""
        return vertices_m @ self.rotation.mT + self.translation_m[:, None]

    def rays(self, image: Tensor, pixels: Tensor) -> Tensor:
        """Directions through pixel centres in camera axes, z = 1, ``[P, 3]``, by camera and flat
        index (row * W + column), int64 ``[P]`` both."""
        dtype = self.inverse.dtype
        rows = torch.div(pixels, self.width, rounding_mode="floor")
        x, y = (pixels - rows * self.width).to(dtype) + 0.5, rows.to(dtype) + 0.5
        inverse = self.inverse[image]
        return inverse[:, :, 0] * x[:, None] + inverse[:, :, 1] * y[:, None] + inverse[:, :, 2]

    def to_head(self, image: Tensor, points_m: Tensor) -> Tensor:
        """Points in camera axes back in the head frame; metres ``[P, 3]`` both."""
        offset = points_m - self.translation_m[image]
        return (self.rotation[image] * offset[:, :, None]).sum(1)


def hit_points(
    seen_m: Tensor, faces: Tensor, views: Views, image: Tensor, pixels: Tensor, triangles: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Where the rays of P covered pixels meet their triangles.

    Args:
        seen_m: Meshes in camera axes (`Views.see`), metres, ``[N, V, 3]``; gradients flow there.
        faces: int64 ``[F, 3]``.
        image: Which image each pixel is of, int64 ``[P]``.
        pixels: Flat index within the image, int64 ``[P]``.
        triangles: From `Rasteriser`, int64 ``[P]``.

    Returns:
        Weights of the triangles' vertices, summing to 1, ``[P, 3]``; depths along the camera's
        axis, metres, ``[P]``; both differentiable; and the rays, z = 1, ``[P, 3]``.
    """
    corners = faces[triangles] + (image * seen_m.shape[1])[:, None]
    rays = views.rays(image, pixels)
    points = seen_m.reshape(-1, 3).index_select(0, corners.view(-1)).view(-1, 3, 3)
    return *interpolation_weights(points, rays), rays


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
    depths = corners[:, :, 2]
    x, y = (corners[:, :, :2] - depths[:, :, None] * rays[:, None, :2]).unbind(2)
    volumes = x.roll(-1, 1) * y.roll(-2, 1) - x.roll(-2, 1) * y.roll(-1, 1)
    total = volumes.sum(1)
    # Within a triangle volumes have one sign; on its border rounding may turn a small one.
    is_sound = total.detach().abs() > EDGE_ON * volumes.detach().abs().sum(1)
    total = torch.where(is_sound, total, 1.0)
    weights = torch.where(is_sound[:, None], volumes / total[:, None], 1 / 3)
    return weights, (weights * depths).sum(1)


NORMAL_SHARE = 4
"""Where pixels are drawn, every fourth has a normal: it needs the depth of two neighbours."""


class DrawnPixels(NamedTuple):
    """What interpolation finds at P pixels of N images.

    Attributes:
        pixels: The pixels, sorted, counted over all images one after another, int64 ``[P]``.
        depth_pixels: Those whose depth is asked for: the same and, with normals, neighbours.
        depth_m: Their depths; differentiable, ``[Q]``.
        depth_image: Which image they are of, int64 ``[Q]``.
        rays: Their directions, z = 1, ``[Q, 3]``.
        centre: Indices into these Q of pixels with both neighbours, int64 ``[R]``.
        right: Of their right neighbours.
        below: Of the neighbours below.
    """

    pixels: Int64Array
    surface: Surface
    depth_pixels: Int64Array
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
        ids = self.rasteriser.triangle_ids(meshes, cameras)
        size, width, device = ids[0].size, cameras[0].width, vertices_m.device
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
        views = Views.of(cameras, vertices_m)
        triangles = torch.from_numpy(ids.reshape(-1)[wanted].astype(np.int64)).to(device)
        image, pixel = (torch.from_numpy(part).to(device) for part in np.divmod(wanted, size))
        weights, depth_m, rays = hit_points(
            views.see(vertices_m), self._faces, views, image, pixel, triangles
        )
        points, at = [image, weights, depth_m, rays, triangles], [image[:0]] * 3
        if normals:
            own, *at = (
                torch.from_numpy(place[places]).to(device)
                for places in (chosen, centre, centre + 1, centre + width)
            )
            points = [values.index_select(0, own) for values in points]
        own_image, own_weights, own_depth_m, own_rays, own_triangles = points
        uv = (own_weights[:, :, None] * self._face_uv.index_select(0, own_triangles)).sum(1)
        xyz_m = views.to_head(own_image, own_rays * own_depth_m[:, None])
        surface = Surface(own_image, uv, xyz_m)
        return DrawnPixels(chosen, surface, wanted, depth_m, image, rays, *at)

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
