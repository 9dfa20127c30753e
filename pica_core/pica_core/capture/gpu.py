"""GL side of the stage: bake an identity's appearance, draw images, depth and unwrapped textures.

One thread owns a `StageRenderer`. All meshes share one topology, so buffers are made once per head.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import moderngl
import numpy as np
import numpy.typing as npt

from pica_core.camera import Camera
from pica_core.capture.heads import Head
from pica_core.capture.occlusion import Occlusion, shade_eyes
from pica_core.gl import create_context, link_program, wait_for_gpu

FloatArray = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]

BAKE_SIZE = 2048
"""Side of the appearance textures: 8 texels per position-map texel, about 0.1 mm on the face."""
SUPERSAMPLE = 2
"""Samples per pixel along each axis."""
BACKGROUND = (92, 97, 104)
"""sRGB of the empty stage; pixels without a head have mask 0."""
NEAR_M, FAR_M = 0.05, 6.0
DEPTH_TOLERANCE_M = 0.0015
"""How far behind the nearest surface a texel may lie and still count as seen."""


def shader_text(name: str) -> str:
    """A shader of this package with its includes resolved (one level)."""
    folder = files("pica_core.capture") / "shaders"
    text = (folder / name).read_text(encoding="utf-8")
    return re.sub(
        r'^#include "([\w.]+)"$',
        lambda found: (folder / found.group(1)).read_text(encoding="utf-8"),
        text,
        flags=re.MULTILINE,
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class View:
    """What one camera sees.

    Attributes:
        image: sRGB, row 0 on top. uint8 ``[H, W, 3]``.
        depth_m: Distance along the camera axis at pixel centres, 0 where empty. float32 ``[H, W]``.
        mask: 0 background, else material id + 1 (`coordinates.MATERIALS`). uint8 ``[H, W]``.
    """

    image: ByteArray
    depth_m: FloatArray
    mask: ByteArray


class StageRenderer:
    """Draws one head on the stage.

    Args:
        head: The head to draw.
        context: A GL context to use; None makes one.
        bake_size: Side of the appearance textures, texels.
        occlusion: False leaves out self-shadowing (and the seconds that measuring it takes).

    Raises:
        GraphicsError: No GL context.
    """

    def __init__(
        self, head: Head, context: Any = None, *, bake_size: int = BAKE_SIZE, occlusion: bool = True
    ) -> None:
        self.head = head
        self._context = create_context() if context is None else context
        self._framebuffers: dict[tuple[str, int, int], Any] = {}
        self._views: dict[tuple[int, int], tuple[Any, Any]] = {}
        c = self._context
        self._programs: dict[str, Any] = {
            name: link_program(
                c, vertex=shader_text(f"{name}.vert"), fragment=shader_text(f"{name}.frag")
            )
            for name in ("stage", "depth", "unwrap", "resolve")
        }
        self._faces = c.buffer(head.faces.tobytes())
        coordinates = head.coordinates
        static = np.concatenate([head.vertex_uv, coordinates.material[:, None]], 1)
        self._static = c.buffer(static.astype(np.float32).tobytes())
        # Moving: position, normal, strand tangent, occlusion.
        self._moving = c.buffer(reserve=head.num_vertices * 11 * 4, dynamic=True)
        moving = ["position_m", "normal", "tangent", "occlusion"]
        self._arrays = {
            "stage": self._array(
                "stage", "3f 3f 3f 2f", moving, "2f 1f", ["vertex_uv", "material"]
            ),
            "depth": self._array("depth", "3f 3x4 3x4 2x4", moving[:1], "2x4 1f", ["material"]),
            "unwrap": self._array("unwrap", "3f 3f 3x4 2x4", moving[:2], "2f 1x4", ["vertex_uv"]),
        }
        self._resolving = c.vertex_array(self._programs["resolve"], [])
        self._colour, self._relief = self._bake(bake_size)
        self._vertices: FloatArray = np.zeros((0, 3), np.float32)
        self._occlusion = Occlusion(head, self._draw_depth_map) if occlusion else None

    def release(self) -> None:
        """Give the context back; the stage is useless afterwards."""
        self._framebuffers.clear()
        self._views.clear()
        self._context.gc()
        self._context.release()

    def _array(
        self,
        program: str,
        moving: str,
        moving_names: list[str],
        static: str,
        static_names: list[str],
    ) -> Any:
        content = [(self._moving, moving, *moving_names), (self._static, static, *static_names)]
        return self._context.vertex_array(self._programs[program], content, self._faces)

    def _bake(self, size: int) -> tuple[Any, Any]:
        c, head, who = self._context, self.head, self.head.identity
        program: Any = link_program(
            c, vertex=shader_text("bake.vert"), fragment=shader_text("appearance.frag")
        )
        numbers: dict[str, Any] = {
            "seed": float(who.seed), "skin_rgb": who.skin.rgb, "redness": who.skin.redness,
            "lip_rgb": who.skin.lip_rgb, "freckles": who.skin.freckles, "stubble": who.skin.stubble,
            "beard_cover": who.skin.beard,
            "makeup": who.skin.makeup, "age": who.skin.age, "brow_rgb": who.skin.brow_rgb,
            "brow_thickness": who.skin.brow_thickness, "iris_rgb": who.skin.iris_rgb,
            "cloth_rgb": who.skin.cloth_rgb, "hair_rgb": who.hair.rgb, "curl": who.hair.curl,
            "sweep": who.hair.sweep,
            "grey": who.hair.grey, **head.landmarks,
        }  # fmt: skip
        for name, value in numbers.items():
            if name in program:
                program[name].value = value
        k = head.coordinates
        data = np.concatenate([head.vertex_uv, k.rest_m, k.local, k.material[:, None]], 1)
        buffer = c.buffer(data.astype(np.float32).tobytes())
        array = c.vertex_array(
            program,
            [(buffer, "2f 3f 4f 1f", "vertex_uv", "rest_m", "local", "material")],
            self._faces,
        )
        targets = [c.texture((size, size), 4) for _ in range(2)]
        framebuffer = c.framebuffer(targets)
        framebuffer.use()
        c.disable(moderngl.DEPTH_TEST | moderngl.CULL_FACE | moderngl.BLEND)
        framebuffer.clear(0, 0, 0, 0)
        array.render()
        texels = [np.frombuffer(target.read(), np.uint32) for target in targets]
        covered = texels[1].view(np.uint8)[3::4].reshape(size, size) > 0
        nearby = _nearby(covered, 2 * size // 256 + 2)
        for index in (1, 0):
            targets[index].write(texels[index][nearby])
            targets[index].build_mipmaps(max_level=4)
            targets[index].filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
            targets[index].repeat_x = targets[index].repeat_y = False
        del framebuffer, array
        c.gc()
        return targets[0], targets[1]

    def pose(self, arkit: npt.ArrayLike) -> FloatArray:
        """Pose the head for the draws that follow; returns its vertices, metres ``[V, 3]``."""
        head = self.head
        vertices = head.vertices(arkit)
        shade = np.ones((len(vertices), 2), np.float32)
        if self._occlusion is not None:
            shade = self._occlusion.at(np.asarray(arkit, np.float32))
        shade_eyes(head, vertices, shade)
        self._upload(vertices, shade)
        return vertices

    def _upload(self, vertices: FloatArray, shade: FloatArray) -> None:
        head = self.head
        data = np.zeros((len(vertices), 11), np.float32)
        data[:, :3] = vertices
        data[:, 3:6] = head.normals(vertices)
        hair = head.charts["hair"]
        grid = vertices[hair.span].reshape(*hair.shape, 3)
        along: FloatArray = np.asarray(np.gradient(grid, axis=0), np.float32)
        data[hair.span, 6:9] = along.reshape(-1, 3)
        data[:, 9:] = shade
        self._moving.write(data.tobytes())
        self._vertices = vertices

    def _framebuffer(self, kind: str, width: int, height: int) -> Any:
        key = (kind, width, height)
        if key not in self._framebuffers:
            c = self._context
            if kind == "colour":
                target = c.texture((width, height), 4)
            elif kind == "geometry":
                target = c.texture((width, height), 2, dtype="f4")
                target.filter = (moderngl.NEAREST, moderngl.NEAREST)
            else:
                target = c.texture((width, height), 4, dtype="f4")
            self._framebuffers[key] = c.framebuffer([target], c.depth_renderbuffer((width, height)))
        return self._framebuffers[key]

    def _draw_depth_map(self, vertices: FloatArray, clip: FloatArray, size: int) -> FloatArray:
        """Depth in [0, 1] along an orthographic `clip`, 1 where empty, row 0 at the bottom."""
        if vertices is not self._vertices:
            self._upload(vertices, np.ones((len(vertices), 2), np.float32))
        framebuffer = self._framebuffer("geometry", size, size)
        framebuffer.use()
        framebuffer.clear(1.0, 0.0, 0.0, 0.0, depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST)
        program = self._programs["depth"]
        program["clip_from_head"].write(np.ascontiguousarray(clip.T).tobytes())
        row = 0.5 * clip[2]
        row[3] += 0.5
        program["depth_plane"].value = tuple(float(value) for value in row)
        self._arrays["depth"].render()
        raw = np.frombuffer(framebuffer.read(components=1, dtype="f4"), np.float32)
        depth: FloatArray = raw.reshape(size, size)
        return depth

    def _camera_uniforms(self, program: Any, camera: Camera) -> None:
        clip = camera.clip_from_world(NEAR_M, FAR_M)
        program["clip_from_head"].write(np.ascontiguousarray(clip.T).tobytes())
        if "camera_m" in program:
            program["camera_m"].value = tuple(camera.centre_m)
        if "depth_plane" in program:
            program["depth_plane"].value = (*camera.rotation[2], camera.translation_m[2])

    def draw(self, camera: Camera) -> View:
        """Image, depth and mask of the posed head."""
        geometry = self._draw_geometry(camera)
        image = self.draw_image(camera)
        depth, mask = _read_geometry(geometry)
        return View(image=image, depth_m=depth, mask=mask)

    def draw_image(self, camera: Camera) -> ByteArray:
        """The camera's sRGB image, supersampled, row 0 on top. uint8 ``[H, W, 3]``."""
        resolved = self._resolve(self._draw_samples(camera), camera)
        wait_for_gpu(self._context)  # encoders may run meanwhile
        image: ByteArray = np.empty((camera.height, camera.width, 3), np.uint8)
        resolved.read_into(image, components=3, alignment=1)
        return image

    def draw_geometry(self, camera: Camera) -> tuple[FloatArray, ByteArray]:
        """Exact depth in metres and mask at pixel centres, row 0 on top. ``[H, W]`` each."""
        return _read_geometry(self._draw_geometry(camera))

    def _draw_geometry(self, camera: Camera) -> Any:
        framebuffer = self._framebuffer("geometry", camera.width, camera.height)
        framebuffer.use()
        framebuffer.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self._camera_uniforms(self._programs["depth"], camera)
        self._arrays["depth"].render()
        return framebuffer

    def _draw_samples(self, camera: Camera) -> Any:
        """The camera's image with its samples; returns their texture."""
        framebuffer = self._framebuffer(
            "colour", camera.width * SUPERSAMPLE, camera.height * SUPERSAMPLE
        )
        framebuffer.use()
        framebuffer.clear(*(value / 255 for value in BACKGROUND), 1.0, depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        program = self._programs["stage"]
        self._camera_uniforms(program, camera)
        program["colour_map"].value, program["relief_map"].value = 0, 1
        self._colour.use(0)
        self._relief.use(1)
        self._arrays["stage"].render()
        return framebuffer.color_attachments[0]

    def _resolve(self, samples: Any, camera: Camera) -> Any:
        """Mean of each pixel's samples, row 0 on top, sRGB."""
        framebuffer = self._framebuffer("colour", camera.width, camera.height)
        framebuffer.use()
        self._context.enable_only(moderngl.NOTHING)
        samples.use(0)
        self._programs["resolve"]["samples"].value = 0
        self._programs["resolve"]["side"].value = SUPERSAMPLE
        self._resolving.render(moderngl.TRIANGLES, vertices=3)
        return framebuffer

    def _view_textures(self, view: View) -> tuple[Any, Any]:
        """A view's image, and its depth with its mask, as textures; row 0 at the bottom."""
        h, w = view.mask.shape
        if (w, h) not in self._views:
            c = self._context
            image, geometry = c.texture((w, h), 3), c.texture((w, h), 2, dtype="f4")
            geometry.filter = (moderngl.NEAREST, moderngl.NEAREST)
            for texture in (image, geometry):
                texture.repeat_x = texture.repeat_y = False
            self._views[w, h] = image, geometry
        image, geometry = self._views[w, h]
        both = np.empty((h, w, 2), np.float32)
        both[..., 0], both[..., 1] = view.depth_m[::-1], view.mask[::-1]
        image.write(np.ascontiguousarray(view.image[::-1]), alignment=1)
        geometry.write(both)
        return image, geometry

    def unwrap(
        self, images: list[tuple[Camera, View]], size: int
    ) -> tuple[ByteArray, npt.NDArray[np.bool_]]:
        """Average texture: every camera's image projected back onto the mesh, where that camera
        sees it.

        Args:
            images: Cameras with what they saw of the pose that is set now.
            size: Side of the texture, texels.

        Returns:
            sRGB texture, row 0 is v = 0, black where nobody looks; and where somebody does.
            uint8 ``[S, S, 3]``, bool ``[S, S]``.
        """
        c = self._context
        framebuffer = self._framebuffer("texture", size, size)
        framebuffer.clear(0.0, 0.0, 0.0, 0.0)
        program = self._programs["unwrap"]
        program["image"].value, program["geometry"].value = 0, 1
        program["tolerance_m"].value = DEPTH_TOLERANCE_M
        for camera, view in images:
            image, geometry = self._view_textures(view)
            framebuffer.use()
            c.enable_only(moderngl.BLEND)
            c.blend_func = moderngl.ONE, moderngl.ONE
            self._camera_uniforms(program, camera)
            image.use(0)
            geometry.use(1)
            self._arrays["unwrap"].render()
        c.enable_only(moderngl.NOTHING)
        raw = np.frombuffer(framebuffer.read(components=4, dtype="f4"), np.float32)
        total = raw.reshape(size, size, 4)
        seen = total[..., 3] > 1e-4
        mean = total[..., :3] / np.maximum(total[..., 3:], 1e-4)
        texture = np.where(seen[..., None], np.rint(255 * np.clip(mean, 0, 1)), 0)
        return texture.astype(np.uint8), seen


def _read_geometry(framebuffer: Any) -> tuple[FloatArray, ByteArray]:
    w, h = framebuffer.size
    both: FloatArray = np.empty((h, w, 2), np.float32)
    framebuffer.read_into(both, components=2, dtype="f4")
    return both[::-1, :, 0].copy(), np.rint(both[::-1, :, 1]).astype(np.uint8)


def _nearby(covered: npt.NDArray[np.bool_], steps: int) -> npt.NDArray[np.int64]:
    """Which texel each texel takes: itself, or a covered one next to an empty one, so that charts
    bleed into the empty texels around them and filtering finds no background.

    Args:
        covered: Where charts are. ``[S, S]``.
        steps: How far they bleed, texels.

    Returns:
        Numbers of texels. ``[S * S]``.
    """
    filled = covered.copy()
    taken = np.arange(covered.size)
    for _ in range(steps):
        for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
            take = np.flatnonzero(np.roll(filled, shift, axis) & ~filled)
            place = list(np.unravel_index(take, covered.shape))
            place[axis] = (place[axis] - shift) % covered.shape[axis]
            taken[take] = taken[np.ravel_multi_index(tuple(place), covered.shape)]
            filled.ravel()[take] = True
    return taken
