"""Rasterisation for training: which triangle of a mesh does each pixel centre see?

GL answers on the CPU, and `TensorRasteriser` in torch where the meshes are on a GPU: nothing then
leaves the GPU, and shapes can be held fixed for a CUDA graph. Both give the same triangles but for
pixels on an edge (one in some thousands), where GL rounds corners to fractions of a pixel. What
lies on the triangle is `pixels`'s question.
"""

from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from typing import NamedTuple, Protocol, Self

import moderngl
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pica_core.camera import Camera
from pica_core.capture.dataset.files import Topology
from pica_core.errors import GraphicsError, ShapeError
from pica_core.gl import create_context, link_program
from pica_core.types import FloatArray, IntArray

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


class Views(NamedTuple):
    """N cameras of one image size as tensors of one dtype on one device.

    Attributes:
        rotation: Head to camera, ``[N, 3, 3]``.
        translation_m: ``[N, 3]``.
        inverse: Of the intrinsics, ``[N, 3, 3]``.
        clip: From head metres to GL clip space (`Camera.clip_from_world`), ``[N, 4, 4]``.
        width: Image columns.
        height: Image rows.
    """

    rotation: Tensor
    translation_m: Tensor
    inverse: Tensor
    clip: Tensor
    width: int
    height: int

    @classmethod
    def of(cls, cameras: Sequence[Camera], like: Tensor | None = None) -> "Views":
        """The cameras with dtype and device of `like`, or as float32 on the CPU.

        Raises:
            ShapeError: They are of several image sizes.
        """
        width, height = cameras[0].width, cameras[0].height
        if any((camera.width, camera.height) != (width, height) for camera in cameras):
            raise ShapeError("cameras of several image sizes; a batch needs one")

        def stack(matrices: Sequence[npt.NDArray[np.floating]]) -> Tensor:
            found = torch.from_numpy(np.stack(matrices))
            return found.to(torch.float32) if like is None else found.to(like)

        return cls(
            stack([camera.rotation for camera in cameras]),
            stack([camera.translation_m for camera in cameras]),
            stack([np.linalg.inv(camera.intrinsics) for camera in cameras]),
            stack([camera.clip_from_world(NEAR_M, FAR_M) for camera in cameras]),
            width,
            height,
        )

    def see(self, vertices_m: Tensor) -> Tensor:
        """Head-frame meshes in their cameras' axes; metres ``[N, V, 3]`` both."""
        return (self.rotation @ vertices_m.mT).mT + self.translation_m[:, None]

    def rays(self, pixels: Tensor) -> Tensor:
        """Directions through pixel centres in camera axes, z = 1, ``[N, K, 3]``, by flat index
        (row * W + column), int64 ``[N, K]``."""
        rows = torch.div(pixels, self.width, rounding_mode="floor")
        x, y = (pixels - rows * self.width).to(self.inverse) + 0.5, rows.to(self.inverse) + 0.5
        along_x, along_y, first = self.inverse[:, None].unbind(3)
        return along_x * x[:, :, None] + along_y * y[:, :, None] + first

    def to_head(self, points_m: Tensor) -> Tensor:
        """Points in camera axes back in the head frame; metres ``[N, K, 3]`` both."""
        return (self.rotation.mT @ (points_m - self.translation_m[:, None]).mT).mT


class Rasteriser(Protocol):
    """Finds the triangles of one mesh topology."""

    def triangles(self, vertices_m: Tensor, views: Views) -> Tensor:
        """The triangle that each pixel centre sees of N meshes in head-frame metres, ``[N, V, 3]``,
        each through its camera; -1 where none. int32 ``[N, H * W]``, row 0 on top."""


class GLRasteriser:
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

    def triangles(self, vertices_m: Tensor, views: Views) -> Tensor:
        """See `Rasteriser`."""
        meshes = vertices_m.detach().to("cpu", torch.float32).numpy()
        with self._context:  # another rasteriser of this thread may have been current
            content = self._draw(meshes, views).read(components=1, dtype="f4")
        size = len(meshes), views.height, views.width
        found = np.frombuffer(content, np.float32).reshape(size)[:, ::-1].astype(np.int32) - 1
        return torch.from_numpy(found.reshape(len(meshes), -1)).to(vertices_m.device)

    def _draw(self, meshes: FloatArray, views: Views) -> moderngl.Framebuffer:
        width, height = views.width, views.height
        target = self._framebuffer(width, height * len(meshes))
        target.use()
        target.clear(0.0, 0.0, 0.0, 0.0)
        matrices = views.clip.to("cpu", torch.float32).mT.contiguous().numpy()
        while len(self._meshes) < len(meshes):
            positions = self._context.buffer(reserve=self.num_vertices * 12, dynamic=True)
            content = [(positions, "3f", "position_m")]
            mesh = self._context.vertex_array(self._program, content, index_buffer=self._indices)
            self._meshes.append((positions, mesh))
        for index, mesh_m in enumerate(meshes):
            positions, vertex_array = self._meshes[index]
            positions.write(np.ascontiguousarray(mesh_m))
            self._program["clip_from_head"].write(matrices[index].tobytes())  # type: ignore[union-attr]
            target.viewport = (0, index * height, width, height)
            vertex_array.render()
        target.viewport = (0, 0, width, height * len(meshes))
        return target

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


ENTRY_MARGIN = 1.5
"""Of `TensorRasteriser.capacity` (chosen: batches of near and far cameras differ)."""


class Capacity:
    """The length of a list that differs from call to call: what is needed, or between `fix` and
    `release` a length that stays, which costs no wait for the GPU; what then finds no room is left
    out.

    Args:
        margin: The fixed length against the most that was needed before.

    Attributes:
        needed: What the last list of a fixed length needed, int64 ``[]``.
    """

    def __init__(self, margin: float) -> None:
        self._margin = margin
        self._most = self._fixed = self._room = 0
        self.needed: Tensor | None = None

    def of(self, needed: Tensor) -> int:
        """The length for a list of `needed` entries."""
        if self._fixed:
            self.needed = needed.clone()
            return self._fixed
        count = int(needed)
        self._most = max(self._most, count)
        return count

    def fix(self) -> None:
        """Give lists one length from now on; where none was seen yet, what they need."""
        self._fixed = self._room = int(self._margin * self._most)

    def release(self) -> None:
        """Give every list what it needs again."""
        self._fixed, self.needed = 0, None

    def was_short(self, needed: int) -> bool:
        """Whether a list of the fixed length, which may go on being used, needed more; `fix` makes
        room for it."""
        self._most = max(self._most, needed)
        return needed > self._room


class TensorRasteriser:
    """Finds triangles in torch, on the device of the meshes.

    Every pixel in the bounding box of every triangle that faces the camera is an entry of one list,
    and the nearest of a pixel's triangles wins by one 64-bit maximum: its inverse depth above its
    index. Of triangles alike in depth the first wins. Triangles that reach nearer than `NEAR_M` are
    left out whole.

    Args:
        faces: Triangles, counter-clockwise seen from outside, ``[F, 3]``.

    Attributes:
        capacity: Of the list of entries.
    """

    def __init__(self, faces: IntArray, device: torch.device | str) -> None:
        self._faces = torch.from_numpy(faces.astype(np.int64)).to(device)
        self.capacity = Capacity(ENTRY_MARGIN)

    @torch.no_grad()
    def triangles(self, vertices_m: Tensor, views: Views) -> Tensor:
        """See `Rasteriser`."""
        table, first, columns, count = self._boxes(vertices_m, views)
        num_pixels = views.width * views.height
        ends = count.cumsum(0)
        entry = torch.arange(self.capacity.of(ends[-1]), device=ends.device)
        triangle = torch.searchsorted(ends, entry, right=True).clamp_max(len(ends) - 1)
        place = (entry - (ends - count).index_select(0, triangle)).to(torch.int32)
        width = columns.index_select(0, triangle)
        row = torch.div(place, width, rounding_mode="floor")
        column = place - row * width
        pixel = first.index_select(0, triangle) + row * views.width + column
        known = table.index_select(0, triangle).unbind(1)
        x, y = column.to(table), row.to(table)
        of_second, of_third, nearness = (
            known[3 * i] + known[3 * i + 1] * x + known[3 * i + 2] * y for i in range(3)
        )
        hit = (of_second >= 0) & (of_third >= 0) & (of_second + of_third <= 1)
        hit &= entry < ends[-1]
        face = triangle % len(self._faces)
        key = (nearness.view(torch.int32).to(torch.int64) << 32) | (len(self._faces) - face)
        nearest = torch.zeros(
            len(vertices_m) * num_pixels, dtype=torch.int64, device=vertices_m.device
        )
        # What misses its triangle says 0 to its own pixel: one place for all would be a queue.
        pixel = torch.where(hit, pixel, entry % len(nearest))
        nearest.scatter_reduce_(0, pixel, torch.where(hit, key, 0), "amax")
        found = torch.where(nearest > 0, len(self._faces) - (nearest & 0xFFFFFFFF), -1)
        return found.to(torch.int32).view(len(vertices_m), num_pixels)

    def _boxes(self, vertices_m: Tensor, views: Views) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The bounding boxes of N times F triangles.

        Returns:
            The weights of the second and third corner and the inverse depth, each at the box's
            first pixel and its change by column and by row, ``[N F, 9]``; the first pixel, counted
            over all images, int64 ``[N F]``; columns, int32 ``[N F]``; and pixels, int64
            ``[N F]``, 0 of what cannot be seen.
        """
        width, height = views.width, views.height
        rows = views.clip.to(torch.float32)
        clip = vertices_m.to(torch.float32) @ rows[:, :, :3].mT + rows[:, None, :, 3]
        nearness = 1 / clip[:, :, 3]
        x = (clip[:, :, 0] * nearness + 1) * (width / 2) - 0.5
        y = (1 - clip[:, :, 1] * nearness) * (height / 2) - 0.5
        points = torch.stack([x, y, nearness], 2)
        a, b, c = (points.index_select(1, corner) for corner in self._faces.unbind(1))
        low, high = torch.minimum(torch.minimum(a, b), c), torch.maximum(torch.maximum(a, b), c)
        size = [width, height]
        x0, y0 = (low[:, :, axis].ceil().clamp(0, size[axis]) for axis in (0, 1))
        x1, y1 = (high[:, :, axis].floor().clamp(-1, size[axis] - 1) for axis in (0, 1))
        columns, lines = (x1 - x0 + 1).clamp_min(0), (y1 - y0 + 1).clamp_min(0)
        ab, ac = b - a, c - a
        area = ab[:, :, 0] * ac[:, :, 1] - ac[:, :, 0] * ab[:, :, 1]
        is_seen = (area < 0) & (low[:, :, 2] > 0) & (high[:, :, 2] < 1 / NEAR_M)
        count = torch.where(is_seen, columns * lines, 0).to(torch.int64)
        scale = 1 / torch.where(is_seen, area, 1)
        second = ac[:, :, 1] * scale, -ac[:, :, 0] * scale
        third = -ab[:, :, 1] * scale, ab[:, :, 0] * scale
        depth = [i * ab[:, :, 2] + j * ac[:, :, 2] for i, j in zip(second, third, strict=True)]
        right, down = x0 - a[:, :, 0], y0 - a[:, :, 1]
        slopes = [second, third, depth]
        starts = [torch.zeros_like(x0), torch.zeros_like(x0), a[:, :, 2]]
        values = [
            value
            for start, (by_x, by_y) in zip(starts, slopes, strict=True)
            for value in (start + by_x * right + by_y * down, by_x, by_y)
        ]
        table = torch.stack(values, 2).view(-1, 9)
        image = torch.arange(len(vertices_m), device=vertices_m.device)[:, None]
        first = (image * height + y0.to(torch.int64)) * width + x0.to(torch.int64)
        columns = columns.to(torch.int32).clamp_min(1)
        return table, first.view(-1), columns.view(-1), count.view(-1)
