"""Rasterisation for training: GL finds the triangle of each pixel, torch the point on it.

GL answers the discrete question (which triangle covers this pixel centre?) and torch the smooth
one (where on that triangle?), so the same code runs on any machine with a GL driver, and gradients
reach the vertices through the interpolation weights.

The weights are those of the ray through the pixel centre. With the triangle's corners p0, p1, p2
in camera axes and the ray d, the hit point is w0 p0 + w1 p1 + w2 p2 with

    w0 : w1 : w2  =  d . (p1 x p2)  :  d . (p2 x p0)  :  d . (p0 x p1)

which is perspective-correct by construction and needs no division but the last. Coverage itself has
no gradient here: a silhouette is moved by the mesh loss, not by the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Self

import moderngl
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pica_core.camera import Camera
from pica_core.errors import GraphicsError, ShapeError
from pica_core.gl import create_context, link_program

_VERTEX = """#version 330 core
uniform mat4 clip_from_head;
in vec3 position_m;
void main() { gl_Position = clip_from_head * vec4(position_m, 1.0); }
"""
_FRAGMENT = """#version 330 core
out float triangle;
void main() { triangle = float(gl_PrimitiveID + 1); }
"""
_MAX_TRIANGLES = 1 << 24
"""Whole numbers that a float32 target holds exactly."""


class Rasteriser:
    """One GL context and one mesh topology for a whole run.

    Use as a context manager, from one thread. Buffers are reused; a new image size makes a new
    framebuffer and releases the old one.

    Args:
        faces: Triangles, counter-clockwise seen from outside, int32 ``[F, 3]``.
        num_vertices: V.

    Raises:
        GraphicsError: No GL context, or more than 2^24 triangles.
        ShapeError: Faces of another shape.
    """

    def __init__(self, faces: npt.NDArray[np.int32], num_vertices: int) -> None:
        if faces.ndim != 2 or faces.shape[1] != 3:
            raise ShapeError(f"faces is {faces.shape}; [F, 3] is needed")
        if len(faces) >= _MAX_TRIANGLES:
            raise GraphicsError(f"{len(faces)} triangles; the id image holds {_MAX_TRIANGLES}")
        self.num_vertices = num_vertices
        self._context = create_context()
        self._program = link_program(self._context, vertex=_VERTEX, fragment=_FRAGMENT)
        self._positions = self._context.buffer(reserve=num_vertices * 12, dynamic=True)
        self._vertex_array = self._context.vertex_array(
            self._program,
            [(self._positions, "3f", "position_m")],
            index_buffer=self._context.buffer(np.ascontiguousarray(faces, np.int32).tobytes()),
        )
        self._target: moderngl.Framebuffer | None = None
        self._context.enable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()

    def release(self) -> None:
        """Give the context back; the rasteriser is useless afterwards."""
        self._target = None
        self._context.gc()
        self._context.release()

    def triangle_ids(
        self, vertices_m: npt.NDArray[np.float32], camera: Camera
    ) -> npt.NDArray[np.int32]:
        """The triangle that each pixel centre sees; -1 where none. int32 ``[H, W]``, row 0 on top.

        Args:
            vertices_m: Head-frame metres, float32 ``[V, 3]``.
            camera: Head-to-camera pose and intrinsics.
        """
        if vertices_m.shape != (self.num_vertices, 3):
            raise ShapeError(
                f"vertices_m is {vertices_m.shape}; [{self.num_vertices}, 3] is needed"
            )
        target = self._framebuffer(camera.width, camera.height)
        self._positions.write(np.ascontiguousarray(vertices_m, np.float32).tobytes())
        matrix = camera.clip_from_world().T
        self._program["clip_from_head"].write(matrix.tobytes())  # type: ignore[union-attr]
        target.use()
        target.clear(0.0, 0.0, 0.0, 0.0)
        self._vertex_array.render()
        ids = np.frombuffer(target.read(components=1, dtype="f4"), np.float32)
        flipped = ids.reshape(camera.height, camera.width)[::-1]
        return flipped.astype(np.int32) - 1

    def _framebuffer(self, width: int, height: int) -> moderngl.Framebuffer:
        if self._target is None or self._target.size != (width, height):
            self._target = None
            self._context.gc()
            self._target = self._context.framebuffer(
                color_attachments=[self._context.texture((width, height), 1, dtype="f4")],
                depth_attachment=self._context.depth_renderbuffer((width, height)),
            )
        return self._target


def pixel_rays(camera: Camera, rows: Tensor, columns: Tensor, dtype: torch.dtype) -> Tensor:
    """Ray directions through pixel centres in camera axes, z = 1. ``[P, 3]``."""
    inverse = torch.as_tensor(np.linalg.inv(camera.intrinsics), dtype=dtype)
    pixels = torch.stack(
        [columns.to(dtype) + 0.5, rows.to(dtype) + 0.5, torch.ones_like(rows, dtype=dtype)], 1
    )
    return pixels @ inverse.T


def interpolation_weights(corners: Tensor, rays: Tensor) -> tuple[Tensor, Tensor]:
    """Perspective-correct weights of the point where each ray meets its triangle's plane.

    Args:
        corners: Triangle corners in camera axes, metres, ``[P, 3 corners, 3]``.
        rays: Ray directions in camera axes with z = 1, ``[P, 3]``.

    Returns:
        Weights summing to 1, ``[P, 3]``, and depth along z in metres, ``[P]``. Differentiable in
        `corners`.

    Not checked: a triangle seen exactly edge-on, or of no area, has no answer; GL draws no pixel of
    it, so it never comes here from `Rasteriser`.
    """
    p0, p1, p2 = corners.unbind(1)
    normals = torch.stack(
        [torch.linalg.cross(p1, p2), torch.linalg.cross(p2, p0), torch.linalg.cross(p0, p1)], 1
    )
    volumes = (normals * rays[:, None]).sum(2)
    total = volumes.sum(1)
    weights = volumes / total[:, None]
    depth = (p0 * normals[:, 0]).sum(1) / total
    return weights, depth


def camera_points(vertices_m: Tensor, camera: Camera) -> Tensor:
    """Head-frame vertices ``[V, 3]`` in camera axes, ``[V, 3]``."""
    rotation = torch.as_tensor(camera.rotation, dtype=vertices_m.dtype)
    translation = torch.as_tensor(camera.translation_m, dtype=vertices_m.dtype)
    return vertices_m @ rotation.T + translation


def interpolate(
    vertices_m: Tensor,
    vertex_uv: Tensor,
    faces: Tensor,
    camera: Camera,
    triangle_ids: npt.NDArray[np.int32],
    pixels: npt.NDArray[np.int64] | Sequence[int],
) -> tuple[Tensor, Tensor, Tensor]:
    """Surface coordinates, positions and depths of some covered pixels of one image.

    Args:
        vertices_m: Head-frame metres, ``[V, 3]``; gradients flow back to it.
        vertex_uv: ``[V, 2]``.
        faces: int64 ``[F, 3]``.
        camera: The image's camera.
        triangle_ids: From `Rasteriser.triangle_ids`, ``[H, W]``.
        pixels: Flat indices (row * W + column) of covered pixels, ``[P]``.

    Returns:
        uv ``[P, 2]``, head-frame positions in metres ``[P, 3]``, depths in metres ``[P]``.
    """
    chosen = np.asarray(pixels, np.int64)
    triangles = torch.from_numpy(triangle_ids.reshape(-1)[chosen].astype(np.int64))
    flat = torch.from_numpy(chosen)
    corners = faces[triangles]
    seen = camera_points(vertices_m, camera)
    rays = pixel_rays(camera, flat // camera.width, flat % camera.width, vertices_m.dtype)
    weights, depth = interpolation_weights(seen[corners], rays)
    uv = (weights[:, :, None] * vertex_uv[corners]).sum(1)
    xyz_m = (weights[:, :, None] * vertices_m[corners]).sum(1)
    return uv, xyz_m, depth
