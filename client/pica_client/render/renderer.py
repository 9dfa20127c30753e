"""Draw avatars with moderngl: what is visible first, then the pixel decoder on exactly those
pixels.

    renderer = Renderer(create_context(), (960, 540))
    renderer.add_avatar("peer-1", avatar)
    renderer.update_maps("peer-1", maps.position_map, maps.expression_map)
    stats = renderer.draw([Placement(slot="peer-1", world_from_head=matrix)], camera)
    image = renderer.read_image()                       # uint8 [H, W, 3], top row first

Each head that has changed since the frame before is drawn into a layer of its own: (1) the surface
pass draws its mesh and keeps, per pixel, the head-frame position, the UV and how much of the
texture it reaches over; (2) the pixel decoder runs where the first pass has found something; (3)
what does not change with the face is drawn with a texture. So what a head hides of itself costs no
decoding, and the pixel decoder runs on whole blocks of pixels: drawn triangle by triangle, a mesh
whose triangles are as small as pixels would run it several times over (llvmpipe and GPUs shade in
blocks of 2x2 or 4x4 per triangle); (4) its silhouette is smoothed, and the bust fades. Then all
layers are laid over the room, the farthest head first (`layers`).

Colours of avatars are sRGB values already and are stored as they come. The renderer belongs to the
thread of its context. Nothing is allocated on the GPU but for a new size of the image or of a head,
a new avatar, or a level of it that is drawn for the first time.
"""

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import moderngl
import numpy as np
import numpy.typing as npt

from pica_client.errors import OptionError
from pica_client.render.draw_list import (
    DrawStats,
    RenderSlot,
    ShownHead,
    View,
    count_draws,
    list_heads,
)
from pica_client.render.gpu_avatar import (
    EXPRESSIONS,
    POSITIONS,
    HeadMaps,
    WeightsPlace,
    upload_avatar,
)
from pica_client.render.gpu_plain import TexturedHead
from pica_client.render.gpu_program import UNIT_VISIBLE_UV, UNIT_VISIBLE_XYZ
from pica_client.render.layers import (
    Images,
    Layer,
    layer_size,
    viewport,
)
from pica_client.render.passes import DrawPasses, LayeredHead
from pica_client.render.room import EMPTY_ROOM, STILL, Room, lens_of
from pica_client.render.scene import Placement
from pica_client.system import Closing
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import POSITION_CHANNELS
from pica_core.camera import Camera
from pica_core.errors import GraphicsError
from pica_core.gl import GL_VERSION, freeing, is_software, wait_for_gpu
from pica_core.reference import BaselineAvatar
from pica_core.types import FloatArray, Image

__all__ = ["DrawStats", "RenderOptions", "Renderer"]

MAX_SIDE_PX = 8192


@dataclass(frozen=True, kw_only=True, slots=True)
class RenderOptions:
    """How avatars are drawn."""

    weights: Literal["auto", "block", "turns"] = "auto"
    """Where the pixel decoder's weights stand: in a uniform block (one program for all avatars), or
    as constants in turns (one program each), for sines by polynomial. "auto" takes the last on
    software rasterisers and the block elsewhere (docs/results.md)."""
    smooth_edges: bool = True
    """Blur stair-steps after shading."""
    filter_encodings: bool = True
    """Average the encoding maps over what a pixel covers of them; else they are looked up at its
    middle alone."""
    fade_busts: bool = False
    """Let heads fade into the room towards their lower border, as in a call; else they are drawn as
    they are."""


class Renderer(Closing):
    """Draws avatars into an image of its own.

    It frees what it does not need any more at once, whatever the context's ``gc_mode``, but for the
    queries of counted pixels, which moderngl cannot free; `close` frees all.

    Args:
        context: GL 3.3 or newer, current on this thread.
        size: Columns and rows, pixels.

    Raises:
        OptionError: A size that is not between 1 and 8192.
        ShaderError: The driver refuses our shaders.
        GraphicsError: The context is older than GL 3.3.
    """

    def __init__(
        self,
        context: moderngl.Context,
        size: tuple[int, int],
        options: RenderOptions | None = None,
    ) -> None:
        if context.version_code < GL_VERSION:
            raise GraphicsError(
                f"the GL context is of version {context.version_code / 100:.1f}; "
                f"{GL_VERSION / 100:.1f} is needed: install or update the graphics driver"
            )
        self._context = context
        _ = context.error  # what other code left is not ours to report
        self._options = options or RenderOptions()
        self.gl_renderer = str(context.info["GL_RENDERER"])
        self.weights = self._choose_weights()
        self._passes = DrawPasses(context, smooth_edges=self._options.smooth_edges)
        self._slots: dict[str, RenderSlot] = {}
        self._layers: dict[tuple[str, int], Layer] = {}
        self._shown: list[LayeredHead] = []
        self._num_versions = 0
        self.size = (0, 0)
        self.resize(size)

    def resize(self, size: tuple[int, int]) -> None:
        """Draw images of another size from now on."""
        if size == self.size:
            return
        if not all(1 <= side <= MAX_SIDE_PX for side in size):
            raise OptionError(f"size is {size[0]}x{size[1]}; each side may be 1 to {MAX_SIDE_PX}")
        self.size = size
        with freeing(self._context):
            self._unbind()
            self._images = Images(self._context, size)
        self._drawn_room: tuple[Room, list[object]] | None = None
        self.forget_frame()

    def forget_frame(self) -> None:
        """Draw the next frame as a whole, whatever stayed the same: for measuring."""
        for layer in self._layers.values():
            layer.look = layer.finish = None

    def add_avatar(self, slot: str, avatar: Avatar) -> None:
        """Put an avatar on the GPU; replaces what was in the slot. Slots with the same avatar
        share.

        Until its first maps come, and after an error, the slot is drawn as a placeholder.

        Raises:
            ShaderError: The avatar cannot be drawn by this driver.
        """
        self.add_placeholder(slot)
        body = next((entry.body for entry in self._slots.values() if entry.avatar is avatar), None)
        if body is None:
            with freeing(self._context):
                body = upload_avatar(
                    self._context,
                    self._passes.mesh_programs,
                    avatar,
                    self.weights,
                    filtered=self._options.filter_encodings,
                    fades=self._options.fade_busts,
                    program=self._program_for(avatar),
                )
        rows = {level: avatar.position_rows(level) for level in avatar.levels}
        self._slots[slot] = RenderSlot(
            version=self._next_version(),
            avatar=avatar,
            body=body,
            maps=HeadMaps(self._context, rows),
        )

    def add_textured(self, slot: str, avatar: BaselineAvatar) -> None:
        """Put a baseline into a slot. Drawn as a placeholder until its first `update_textured`."""
        self.add_placeholder(slot)
        program, fades = self._passes.mesh_programs.static, self._options.fade_busts
        head = TexturedHead(self._context, program, avatar, fades=fades)
        self._slots[slot] = RenderSlot(textured=head, version=self._next_version())

    def add_placeholder(self, slot: str) -> None:
        """Show a stand-in for a person whose avatar is not there or cannot be used."""
        self.remove(slot)
        self._slots[slot] = RenderSlot(version=self._next_version())

    def remove(self, slot: str) -> None:
        """Forget a slot and free what no other slot uses; an unknown one is no error."""
        with freeing(self._context):
            self._unbind()
            self._slots.pop(slot, None)
            self._shown = [each for each in self._shown if each[0].slot != slot]

    def close(self) -> None:
        """Free all that it holds on the GPU; only `remove` is allowed afterwards."""
        with freeing(self._context):
            self._unbind()
            self._slots.clear()
            self._layers.clear()
            self._shown.clear()
            for name in ("_passes", "_images"):
                vars(self).pop(name, None)

    def update_maps(
        self,
        slot: str,
        position_map: FloatArray | None,
        expression_map: FloatArray | None,
    ) -> None:
        """Upload freshly decoded maps of one level.

        Args:
            slot: Has an avatar; otherwise nothing happens (it may have left meanwhile).
            position_map: Metres, float32 ``[S, S, 3]`` at the full level, the sheet of a coarser
                one's vertices ``[R, S, 3]``. None keeps the one that is there.
            expression_map: float32 ``[S, S, C]``, or None.

        Raises:
            ShapeError: Maps of another size than the avatar's levels. Nothing is changed.
        """
        entry = self._slots.get(slot)
        if entry is None or entry.maps is None:
            return
        entry.maps.write(position_map, expression_map)
        entry.version = self._next_version()

    def map_targets(
        self, slot: str, level: int, *, both: bool
    ) -> tuple[moderngl.Framebuffer | None, moderngl.Framebuffer] | None:
        """Where a decoder in shaders is to draw a slot's positions and expressions of a level now;
        without `both` the positions stay. None for a slot without an avatar."""
        entry = self._slots.get(slot)
        if entry is None or entry.maps is None:
            return None
        entry.version = self._next_version()
        positions = entry.maps.target(level, POSITIONS) if both else None
        return positions, entry.maps.target(level, EXPRESSIONS)

    def update_textured(self, slot: str, vertices_m: FloatArray, texture: FloatArray) -> None:
        """Upload what a baseline's decoder made; see `TexturedHead.update`."""
        entry = self._slots.get(slot)
        if entry is not None and entry.textured is not None:
            entry.textured.update(vertices_m, texture)
            entry.body = entry.textured.body
            entry.version = self._next_version()

    def draw(
        self,
        placements: Sequence[Placement],
        *cameras: Camera,
        room: Room = EMPTY_ROOM,
        count_pixels: bool = False,
    ) -> DrawStats:
        """Draw one frame into the renderer's image.

        What GL state moderngl can set it sets itself; the rest, above all ``glClipControl``, is to
        be as GL has it at first. Nothing is put back: afterwards the framebuffer is one of its own,
        and flags, texture units 0 to 9 and uniform block 0 are as it used them.

        Args:
            placements: Heads; unknown slots are left out. The order does not matter.
            cameras: World to image. Those of several eyes share its columns from left to right;
                all see the same maps: one decode serves them.
            count_pixels: Count shaded pixels; waits for the GPU.
        """
        passes = self._passes
        passes.begin()
        (width, height), count = self.size, len(cameras)
        edges = [width * number // count for number in range(count + 1)]
        views = [
            (camera, (left, 0, right, height))
            for camera, (left, right) in zip(cameras, pairwise(edges), strict=True)
        ]
        self._draw_room(room, views)
        heads = list_heads(self._slots, placements, views, passes.placeholder)
        self._shown = shown = self._with_layers(heads)
        changed = [(head, layer) for head, layer in shown if layer.look != head.look]
        _crop(changed)
        passes.surfaces(changed)
        pixels = passes.colour(changed, count=count_pixels)
        for head, layer in changed:
            layer.look = head.look
        passes.finish(self._images, self._unfinished())
        passes.place(self._images, self._farthest_first)
        return count_draws(heads, [head for head, _ in changed], pixels, passes.placeholder)

    def _unfinished(self) -> list[LayeredHead]:
        """Heads that are laid over the room otherwise than before; they count as finished."""
        found: list[LayeredHead] = []
        for head, layer in self._shown:
            finish = head.look, head.opacity, self._drawn_room if head.fades else None
            if layer.finish != finish:
                layer.finish = finish
                found.append((head, layer))
        return found

    @property
    def _farthest_first(self) -> list[LayeredHead]:
        return sorted(self._shown, key=lambda each: -float(each[0].matrix[3, 3]))

    def _draw_room(self, room: Room, views: Sequence[View]) -> None:
        """Draw the room where it looks different."""
        seen = [(camera if room != EMPTY_ROOM else STILL, rect) for camera, rect in views]
        eyes: list[object] = [
            (lens_of(eye), eye.rotation.tobytes(), eye.translation_m.tobytes(), rect)
            for eye, rect in seen
        ]
        if (room, eyes) != self._drawn_room:
            self._passes.draw_room(self._images, seen, room)
            self._drawn_room = room, eyes

    def _with_layers(self, heads: Sequence[ShownHead]) -> list[LayeredHead]:
        """Heads with the layers that they are drawn into; what no head needs any more is freed."""
        kept: dict[tuple[str, int], Layer] = {}
        for head in heads:
            layer = self._layers.get((head.slot, head.view[0]))
            if layer is not None and layer.serves(head.size, head.scale):
                kept[head.slot, head.view[0]] = layer
        with freeing(self._context) if len(kept) < len(self._layers) else nullcontext():
            self._unbind()
            self._shown = []
            self._layers = kept
        for head in heads:
            if (head.slot, head.view[0]) not in kept:
                size = layer_size(head.size)
                kept[head.slot, head.view[0]] = Layer(self._context, size, head.scale)
        return [(head, kept[head.slot, head.view[0]]) for head in heads]

    def read_image(self) -> Image:
        """The last frame, uint8 ``[H, W, 3]``, top row first: the colours of `read_pixels`."""
        return self.read_pixels()[..., :3]

    def read_pixels(self) -> Image:
        """The last frame as it lies in memory, uint8 ``[H, W, 4]``, top row first. Waits for the
        GPU.

        What is returned is a view of the rows as GL stores them and cannot be written: copying it
        is left to what needs it, away from the drawing thread.

        Raises:
            GraphicsError: The driver has lost the context or ran out of memory.
        """
        width, height = self.size
        wait_for_gpu(self._context)
        self.check()
        # Four components are read as they lie in memory; three would be repacked pixel by pixel.
        data = self._images.final.read(components=4)
        image: Image = np.frombuffer(data, np.uint8).reshape(height, width, 4)
        return image[::-1]

    def read_surface(self) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int32]]:
        """What the last frame shows, top row first; for tests and picking.

        Returns:
            Head-frame positions in metres ``[H, W, 3]``, UVs ``[H, W, 2]``, and the index of the
            head among the shown ones, -1 where there is none, ``[H, W]``. Positions and UVs are of
            decoded pixels; elsewhere they are anything.
        """
        width, height = self.size
        heads = np.full((height, width), -1, np.int32)
        xyz_m = np.zeros((height, width, 3), np.float32)
        uv = np.zeros((height, width, 2), np.float32)
        for head, layer in self._farthest_first:
            left, bottom, columns, rows = viewport(head.rect)
            image = np.s_[bottom : bottom + rows, left : left + columns]
            drawn = np.ix_(
                *(
                    (layer.scale * (np.arange(side) + 0.5)).astype(np.intp)
                    for side in (rows, columns)
                )
            )
            own = (layer.read(layer.depth)[drawn] < 1).all(axis=2)
            heads[image][own] = self._shown.index((head, layer))
            for found, unit in ((xyz_m, UNIT_VISIBLE_XYZ), (uv, UNIT_VISIBLE_UV)):
                values = layer.read(layer.visible[unit])[drawn]
                found[image][own] = values[own][:, : found.shape[2]]
        return xyz_m[::-1], uv[::-1] / np.float32(65535), heads[::-1]

    def read_maps(self, slot: str) -> tuple[FloatArray, FloatArray]:
        """The newest maps of an avatar, positions and expressions; for tests."""
        maps = self._slots[slot].maps
        assert maps is not None  # of an avatar
        position, expression = (
            np.frombuffer(texture.read(), np.float32).reshape(*texture.size[::-1], -1)
            for texture in maps.newest
        )
        return position[..., :POSITION_CHANNELS], expression

    @property
    def image(self) -> moderngl.Framebuffer:
        """The last frame, for code that draws over it."""
        return self._images.final

    def present(self, target: moderngl.Framebuffer) -> None:
        """Copy the last frame to a window's framebuffer of the same size."""
        self._context.copy_framebuffer(target, self._images.final)

    def check(self) -> None:
        """Ask the driver whether all is well; costs as much as waiting for the GPU.

        Raises:
            GraphicsError: It has lost the context, or ran out of memory.
        """
        error = self._context.error
        if error != "GL_NO_ERROR":
            raise GraphicsError(
                f"the graphics driver reports {error}; start again, and if it stays, "
                "make the window smaller or update the driver"
            )

    def _next_version(self) -> int:
        self._num_versions += 1
        return self._num_versions

    def _unbind(self) -> None:
        """Bind the default framebuffer: freeing one that is bound is an error to moderngl."""
        self._context.detect_framebuffer(0).use()

    def _program_for(self, avatar: Avatar) -> moderngl.Program | None:
        """Another avatar's program of the same spec, which serves where weights are in a block."""
        if self.weights != "block":
            return None
        for entry in self._slots.values():
            other, body = entry.avatar, entry.body
            if other and body and body.shade and other.spec == avatar.spec:
                return body.shade.program
        return None

    def _choose_weights(self) -> WeightsPlace:
        if self._options.weights != "auto":
            return self._options.weights
        return "turns" if is_software(self.gl_renderer) else "block"


def _crop(heads: Sequence[LayeredHead]) -> None:
    """Give layers the matrices that their heads are drawn with: clip space of the view, of which a
    layer shows the head's rectangle."""
    if not heads:
        return
    # All heads at once: numpy takes as long for one as for twenty.
    rects = np.array([(*viewport(head.view), *head.rect[:2], *layer.size) for head, layer in heads])
    starts, sides, corners, own = np.split(rects, 4, axis=1)
    scales = np.array([layer.scale for _, layer in heads])[:, None] / own
    moved = (2 * (starts - corners) + sides) * scales - 1
    matrices = np.array([head.matrix for head, _ in heads], np.float32)
    matrices[:, :2] = (sides * scales)[..., None] * matrices[:, :2] + (
        moved[..., None] * matrices[:, 3:]
    )
    for (_, layer), columns in zip(heads, matrices.transpose(0, 2, 1), strict=True):
        layer.clip_from_head = columns.tobytes()
