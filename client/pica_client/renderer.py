"""Draw avatars with moderngl: what is visible first, then the pixel decoder on exactly those
pixels.

    renderer = Renderer(create_context(), (960, 540))
    renderer.add_avatar("peer-1", avatar)
    renderer.update_maps("peer-1", maps.position_map, maps.expression_map)
    stats = renderer.draw([Placement(slot="peer-1", world_from_head=matrix)], camera)
    image = renderer.read_image()                       # uint8 [H, W, 3], top row first

A frame is: (1) the surface pass draws all meshes and keeps, per pixel, the head-frame position, the
UV and whose it is; (2) a shade pass per avatar covers the rectangle of its head, and runs the pixel
decoder where the first pass says the pixel is its own; (3) edges are smoothed; (4) overlays are
blended. So a hidden pixel costs no decoding, and the pixel decoder runs on whole blocks of pixels:
drawn triangle by triangle, a mesh whose triangles are as small as pixels would run it several times
over (llvmpipe and GPUs shade in blocks of 2x2 or 4x4 per triangle).

Colours of avatars are sRGB values already and are stored as they come. The renderer belongs to the
thread of its context. After the first frame nothing is allocated on the GPU until avatars, size or
texts change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import moderngl
import numpy as np
import numpy.typing as npt

from pica_client.errors import OptionError
from pica_client.gpu_avatar import (
    UNIT_EXPRESSION,
    UNIT_POSITION,
    UNIT_VISIBLE_UV,
    UNIT_VISIBLE_XYZ,
    Shared,
    WeightsPlace,
    build_program,
    expression_texture,
    position_texture,
    set_matrix,
    upload_avatar,
    upload_placeholder,
)
from pica_client.overlay import Overlay, OverlayItem
from pica_client.scene import Placement, clip_from_head, screen_rect
from pica_client.shader_source import compose
from pica_core.avatar_file import Avatar
from pica_core.camera import Camera
from pica_core.errors import ShapeError
from pica_core.gl import wait_for_gpu

FloatArray = npt.NDArray[np.float32]
Image = npt.NDArray[np.uint8]

MAX_SIDE_PX = 8192
FADED = (0.16, 0.18, 0.21)
"""Colour that stale heads fade to: the room's wall."""
MAX_FADE = 0.75
"""A head that has faded completely can still be made out."""
BOUNDS_MARGIN_M = 0.01
_WHOLE_SCREEN = (-1.0, -1.0, 1.0, 1.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class RenderOptions:
    """How avatars are drawn."""

    weights: Literal["auto", "block", "constants"] = "auto"
    """Where the pixel decoder's weights stand: in a uniform block (one program for all avatars) or
    as constants (one program each). "auto" takes constants on software rasterisers, where they draw
    three times as fast (98 K pixels on llvmpipe: 83 ms and 29 ms), and the block elsewhere."""
    smooth_edges: bool = True
    """Blur stair-steps after shading."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DrawStats:
    """What one frame drew; counts, not times."""

    num_avatars: int
    """Avatars on the screen with decoded maps."""
    num_placeholders: int
    num_triangles: int
    num_draw_calls: int
    shaded_pixels: int | None
    """Pixels that the pixel decoder coloured; None unless asked for."""


@dataclass(slots=True, eq=False)
class _Slot:
    avatar: Avatar | None = None
    shared: Shared | None = None
    position: moderngl.Texture | None = None
    expression: moderngl.Texture | None = None
    has_maps: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Head:
    """One head that is on the screen."""

    shared: Shared
    position: moderngl.Texture
    expression: moderngl.Texture | None
    """None for the placeholder."""
    matrix: FloatArray
    rect: tuple[float, float, float, float]
    fade: float


class Renderer:
    """Draws avatars into an image of its own.

    Args:
        context: GL 3.3 or newer, current on this thread.
        size: Columns and rows, pixels.
        options: See `RenderOptions`.

    Raises:
        OptionError: A size that is not between 1 and 8192.
        ShaderError: The driver refuses our shaders.
    """

    def __init__(
        self,
        context: moderngl.Context,
        size: tuple[int, int],
        options: RenderOptions | None = None,
    ) -> None:
        self._context = context
        self._options = options or RenderOptions()
        self.gl_renderer = str(context.info["GL_RENDERER"])
        self._weights = self._choose_weights()
        self._mesh_program = build_program(context, compose("mesh.vert"), compose("surface.frag"))
        self._background = self._screen_program("background.frag")
        self._smooth = self._screen_program("smooth_edges.frag")
        self._background_rect = context.vertex_array(self._background, [])
        self._smooth_rect = context.vertex_array(self._smooth, [])
        self._placeholder = upload_placeholder(context, self._mesh_program)
        self._overlay = Overlay(context)
        self._slots: dict[str, _Slot] = {}
        self._query = context.query(samples=True)
        self.size = (0, 0)
        self.resize(size)

    def resize(self, size: tuple[int, int]) -> None:
        """Draw images of another size from now on."""
        if size == self.size:
            return
        if not all(1 <= side <= MAX_SIDE_PX for side in size):
            raise OptionError(f"size is {size[0]}x{size[1]}; each side may be 1 to {MAX_SIDE_PX}")
        self.size = size
        context = self._context
        self._visible = {
            UNIT_VISIBLE_XYZ: context.texture(size, 4, dtype="f4"),
            UNIT_VISIBLE_UV: context.texture(size, 2, dtype="f4"),
        }
        for texture in self._visible.values():
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._surface = context.framebuffer(
            color_attachments=list(self._visible.values()),
            depth_attachment=context.depth_renderbuffer(size),
        )
        self._shaded_image = context.texture(size, 4)
        self._shaded_image.repeat_x = self._shaded_image.repeat_y = False
        self._shaded = context.framebuffer(color_attachments=[self._shaded_image])
        self._final = context.framebuffer(color_attachments=[context.texture(size, 4)])
        self._room = context.framebuffer(color_attachments=[context.texture(size, 4)])
        self._draw_room()
        context.gc()

    def add_avatar(self, slot: str, avatar: Avatar) -> None:
        """Put an avatar on the GPU; replaces what was in the slot. Slots with the same avatar
        share.

        Until its first maps come, and after an error, the slot is drawn as a placeholder.

        Raises:
            ShaderError: The avatar cannot be drawn by this driver.
        """
        self.add_placeholder(slot)
        shared = next(
            (entry.shared for entry in self._slots.values() if entry.avatar is avatar), None
        )
        if shared is None:
            shared = upload_avatar(self._context, self._mesh_program, avatar, self._weights)
        self._slots[slot] = _Slot(
            avatar=avatar,
            shared=shared,
            position=position_texture(self._context, avatar.tensors["geometry.mean"]),
            expression=expression_texture(self._context, avatar.spec),
        )

    def add_placeholder(self, slot: str) -> None:
        """Show a stand-in for somebody whose avatar is not there or cannot be used."""
        self.remove(slot)
        self._slots[slot] = _Slot()

    def remove(self, slot: str) -> None:
        """Forget a slot and free what nobody else uses; an unknown one is no error."""
        if self._slots.pop(slot, None) is not None:
            self._context.gc()

    def update_maps(self, slot: str, position_map: FloatArray, expression_map: FloatArray) -> None:
        """Upload freshly decoded maps.

        Args:
            slot: Has an avatar; otherwise nothing happens (it may have left meanwhile).
            position_map: Metres, float32 ``[S, S, 3]``.
            expression_map: float32 ``[S, S, C]``.

        Raises:
            ShapeError: Maps of another size than the avatar's.
        """
        entry = self._slots.get(slot)
        if entry is None or entry.position is None or entry.expression is None:
            return
        for texture, array in ((entry.position, position_map), (entry.expression, expression_map)):
            wanted = (texture.height, texture.width, texture.components)
            if array.shape != wanted or array.dtype != np.float32:
                raise ShapeError(f"map is {array.dtype} {array.shape}; float32 {wanted} is needed")
            texture.write(np.ascontiguousarray(array))
        entry.has_maps = True

    def draw(
        self,
        placements: Sequence[Placement],
        camera: Camera,
        overlays: Sequence[OverlayItem] = (),
        *,
        count_pixels: bool = False,
    ) -> DrawStats:
        """Draw one frame into the renderer's image.

        Args:
            placements: Heads; unknown slots are left out. The order does not matter.
            camera: World to image; its size should be the renderer's.
            overlays: Texts on top, in this order.
            count_pixels: Count shaded pixels; waits for the GPU.
        """
        heads = self._visible_heads(placements, camera)
        self._draw_surfaces(heads)
        self._context.copy_framebuffer(self._shaded, self._room)
        shaded_pixels = None
        if count_pixels:
            with self._query:
                self._shade(heads)
            shaded_pixels = int(self._query.samples)
        else:
            self._shade(heads)
        self._finish(heads, overlays)
        num_placeholders = sum(head.expression is None for head in heads)
        return DrawStats(
            num_avatars=len(heads) - num_placeholders,
            num_placeholders=num_placeholders,
            num_triangles=sum(head.shared.num_triangles for head in heads),
            num_draw_calls=(2 + self._options.smooth_edges) * len(heads) + len(overlays),
            shaded_pixels=shaded_pixels,
        )

    def read_image(self) -> Image:
        """The last frame, uint8 ``[H, W, 3]``, top row first. Waits for the GPU."""
        width, height = self.size
        wait_for_gpu(self._context)
        # Four components are read as they lie in memory; three would be repacked pixel by pixel.
        data = self._final.read(components=4)
        image = np.frombuffer(data, np.uint8).reshape(height, width, 4)
        return np.ascontiguousarray(image[::-1, :, :3])

    def read_surface(self) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int32]]:
        """What the last frame's surface pass saw, top row first; for tests and picking.

        Returns:
            Head-frame positions in metres ``[H, W, 3]``, UVs ``[H, W, 2]``, and the index of the
            head among the drawn ones, -1 where there is none, ``[H, W]``.
        """
        width, height = self.size
        xyz = np.frombuffer(self._visible[UNIT_VISIBLE_XYZ].read(), np.float32)
        uv = np.frombuffer(self._visible[UNIT_VISIBLE_UV].read(), np.float32)
        xyz = xyz.reshape(height, width, 4)[::-1]
        return xyz[..., :3], uv.reshape(height, width, 2)[::-1], xyz[..., 3].astype(np.int32) - 1

    def present(self, target: moderngl.Framebuffer) -> None:
        """Copy the last frame to a window's framebuffer of the same size."""
        self._context.copy_framebuffer(target, self._final)

    def _choose_weights(self) -> WeightsPlace:
        if self._options.weights != "auto":
            return self._options.weights
        name = self.gl_renderer.lower()
        is_software = any(word in name for word in ("llvmpipe", "softpipe", "swiftshader"))
        return "constants" if is_software else "block"

    def _screen_program(self, name: str) -> moderngl.Program:
        return build_program(self._context, compose("rect.vert"), compose(name))

    def _draw_room(self) -> None:
        """The background never changes, so it is drawn once per size and copied into each frame."""
        self._room.use()
        self._context.disable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self._background["aspect"] = self.size[0] / self.size[1]
        _set_rect(self._background, _WHOLE_SCREEN)
        self._background_rect.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def _visible_heads(self, placements: Sequence[Placement], camera: Camera) -> list[_Head]:
        found = []
        for placement in placements:
            entry = self._slots.get(placement.slot)
            if entry is None:
                continue
            shared, expression = self._placeholder, None
            position: moderngl.Texture | None = self._placeholder.textures[UNIT_POSITION]
            if entry.has_maps and entry.shared is not None:
                shared, position, expression = entry.shared, entry.position, entry.expression
            matrix = clip_from_head(camera, placement.world_from_head)
            low = np.asarray(shared.low_m) - BOUNDS_MARGIN_M
            high = np.asarray(shared.high_m) + BOUNDS_MARGIN_M
            rect = screen_rect(matrix, low, high)
            if rect is not None and position is not None:
                fade = min(max(placement.fade, 0.0), 1.0) * MAX_FADE
                found.append(_Head(shared, position, expression, matrix, rect, fade))
        return found

    def _draw_surfaces(self, heads: list[_Head]) -> None:
        self._surface.use()
        self._surface.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self._context.enable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        for number, head in enumerate(heads, start=1):
            head.position.use(UNIT_POSITION)
            set_matrix(self._mesh_program, "clip_from_head", head.matrix)
            self._mesh_program["slot"] = float(number)
            head.shared.mesh.render()

    def _shade(self, heads: list[_Head]) -> None:
        self._shaded.use()
        self._context.disable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        for unit, texture in self._visible.items():
            texture.use(unit)
        for number, head in enumerate(heads, start=1):
            head.shared.bind()
            if head.expression is not None:
                head.expression.use(UNIT_EXPRESSION)
            program = head.shared.shade
            program["slot"] = float(number)
            program["tint"] = (*FADED, head.fade)
            _set_rect(program, head.rect)
            head.shared.shade_rect.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def _finish(self, heads: list[_Head], overlays: Sequence[OverlayItem]) -> None:
        self._context.copy_framebuffer(self._final, self._shaded)
        self._final.use()
        if self._options.smooth_edges:
            self._shaded_image.use(0)
            self._smooth["texel"] = (1 / self.size[0], 1 / self.size[1])
            for head in heads:
                _set_rect(self._smooth, head.rect)
                self._smooth_rect.render(moderngl.TRIANGLE_STRIP, vertices=4)
        self._overlay.draw(overlays, self.size)


def _set_rect(program: moderngl.Program, rect: tuple[float, ...]) -> None:
    member: Any = program["rect"]
    member.value = rect
