"""GL side of the stage: draw images, depth and masks of a head, and unwrap textures.

A subclass paints its appearance; all else is here. The mesh keeps its topology, so buffers are made
once.
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import moderngl
import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt

from pica_core.camera import Camera
from pica_core.capture.stage.shadow import Occlusion, PosedMesh, ShadowPlan
from pica_core.gl import create_context, link_program, wait_for_gpu
from pica_core.types import Array, BoolArray, ByteArray, FloatArray, Int64Array, IntArray

BAKE_SIZE = 2048
"""Side of the appearance textures: 8 texels per position-map texel, about 0.1 mm on the face."""
SUPERSAMPLE = 2
"""Samples per pixel along each axis."""
BACKGROUND = (92, 97, 104)
"""sRGB of the empty stage; pixels without a head have mask 0."""
NEAR_M, FAR_M = 0.05, 6.0
DEPTH_TOLERANCE_M = 0.0015
"""How far behind the nearest surface a texel may lie and still count as seen."""


def shader_text(name: str, material: int | None = None) -> str:
    """A shader of this package with its includes resolved (one level) and ``MATERIAL`` defined."""
    folder = files("pica_core.capture.stage") / "shaders"
    text = (folder / name).read_text(encoding="utf-8")
    if material is not None:
        text = text.replace("\n", f"\n#define MATERIAL {material}\n#line 2\n", 1)
    return re.sub(
        r'^#include "([\w.]+)"$',
        lambda found: (folder / found.group(1)).read_text(encoding="utf-8"),
        text,
        flags=re.MULTILINE,
    )


def _set_uniforms(program: Any, values: Mapping[str, Any]) -> None:
    """Set what the program has of these; the compiler drops what a shader does not need."""
    for name, value in values.items():
        if name in program:
            program[name].value = value


def _attributes(program: Any, buffer: Any, layout: Mapping[str, int]) -> tuple[Any, ...]:
    """What a program has of a float32 buffer, for `Context.vertex_array`; may be empty."""
    used = [name for name in layout if name in program]
    parts = [f"{n}f" if name in used else f"{n}x4" for name, n in layout.items()]
    return (buffer, " ".join(parts), *used) if used else ()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class View:
    """What one camera sees.

    Attributes:
        image: sRGB, row 0 on top. uint8 ``[H, W, 3]``.
        depth_m: Distance along the camera axis at pixel centres, 0 where empty. float32 ``[H, W]``.
        mask: 0 background, else material id + 1 (`multiface.MATERIALS`). uint8 ``[H, W]``.
    """

    image: ByteArray
    depth_m: FloatArray
    mask: ByteArray


class MeshRenderer(ABC):
    """Draws one head on the stage. One thread owns a renderer.

    Args:
        faces: Triangles. int32 ``[F, 3]``.
        vertex_uv: In [0, 1]. float32 ``[V, 2]``.
        material: `multiface.MATERIALS` by vertex; the last vertex of a triangle counts. ``[V]``.
        bake_size: Side of the appearance textures, texels.
        shadows: How shadow of the head on itself is measured, which takes seconds; None leaves it
            out.

    Raises:
        GraphicsError: No GL context.
    """

    def __init__(
        self,
        head: PosedMesh,
        *,
        faces: IntArray,
        vertex_uv: FloatArray,
        material: Array,
        bake_size: int,
        shadows: ShadowPlan | None,
    ) -> None:
        self._context = c = create_context()
        self._mesh = head
        self._framebuffers: dict[tuple[str, int, int], Any] = {}
        self._view_textures: dict[tuple[int, int], tuple[Any, Any]] = {}
        self._layout = {"position_m": 3, "normal": 3, "occlusion": 2, "tangent": 3}
        by_face = np.rint(material[faces[:, 2]]).astype(np.int64)
        order = np.argsort(by_face, kind="stable")
        self._faces = c.buffer(np.ascontiguousarray(faces[order], np.int32).tobytes())
        self._spans = _spans(by_face[order])
        static = np.concatenate([vertex_uv, material[:, None]], 1)
        self._static = c.buffer(static.astype(np.float32).tobytes())
        stride = 4 * sum(self._layout.values())
        self._moving = c.buffer(reserve=len(vertex_uv) * stride, dynamic=True)
        self._shade = {k: self._over_mesh("stage", k) for k in self._spans}
        self._depth = self._over_mesh("depth")
        self._unwrap = self._over_mesh("unwrap")
        self._resolve = c.vertex_array(self._program("resolve", "resolve"), [])
        self._vertices: FloatArray = np.zeros((0, 3), np.float32)
        self._colour, self._relief = self._bake(bake_size)
        self._occlusion = Occlusion(head, faces, self._draw_depth_map, shadows) if shadows else None

    @abstractmethod
    def _paint(self) -> None:
        """Draw colour and relief of every part over the charts, by `_paint_part`."""

    @abstractmethod
    def _strands(self, vertices: FloatArray, shade: FloatArray) -> FloatArray:
        """Directions of strands ``[V, 3]``; may change the vertices' light ``[V, 2]`` in place."""

    def pose(self, arkit: npt.ArrayLike) -> FloatArray:
        """Pose the head for the draws that follow; returns its vertices, metres ``[V, 3]``."""
        vertices = self._mesh.vertices(arkit)
        shade = np.ones((len(vertices), 2), np.float32)
        if self._occlusion is not None:
            shade = self._occlusion.at(np.asarray(arkit, np.float32))
        self._upload(vertices, shade)
        return vertices

    def _upload(self, vertices: FloatArray, shade: FloatArray) -> None:
        tangent = self._strands(vertices, shade)
        values = vertices, self._mesh.normals(vertices), shade, tangent
        self._moving.write(np.concatenate(values, 1, dtype=np.float32, casting="same_kind"))
        self._vertices = vertices

    def release(self) -> None:
        """Give the context back; the renderer is useless afterwards."""
        self._framebuffers.clear()
        self._view_textures.clear()
        self._context.gc()
        self._context.release()

    def _program(self, vertex: str, fragment: str, material: int | None = None) -> Any:
        return link_program(
            self._context,
            vertex=shader_text(f"{vertex}.vert"),
            fragment=shader_text(f"{fragment}.frag", material),
        )

    def _over_mesh(self, shader: str, material: int | None = None) -> Any:
        """The mesh with a program that takes what it wants of the vertices."""
        program = self._program(shader, shader, material)
        buffers = (self._moving, self._layout), (self._static, {"vertex_uv": 2, "material": 1})
        content = [_attributes(program, *pair) for pair in buffers]
        return self._context.vertex_array(program, [each for each in content if each], self._faces)

    def _bake(self, size: int) -> tuple[Any, Any]:
        """Paint the textures ``colour_map`` and ``relief_map``, and let charts bleed."""
        c = self._context
        colour, relief = c.texture((size, size), 4), c.texture((size, size), 4)
        framebuffer = c.framebuffer([colour, relief])
        framebuffer.use()
        c.enable_only(moderngl.NOTHING)
        framebuffer.clear(0, 0, 0, 0)
        self._paint()
        _settle((colour, relief))
        del framebuffer
        c.gc()
        return colour, relief

    def _paint_part(
        self,
        shaders: tuple[str, str],
        material: int,
        corners: tuple[Any, dict[str, int]],
        faces: Any,
        values: Mapping[str, Any],
        **span: int,
    ) -> None:
        """Draw one part's appearance: vertex and fragment shader, a buffer of vertices with its
        layout, triangles, uniforms, and which of the triangles."""
        program = self._program(*shaders, material)
        _set_uniforms(program, values)
        content = [_attributes(program, *corners)]
        self._context.vertex_array(program, content, faces).render(**span)

    def _framebuffer(self, kind: str, width: int, height: int) -> Any:
        key = (kind, width, height)
        if key not in self._framebuffers:
            c, size = self._context, (width, height)
            components, dtype = {"colour": (4, "f1"), "geometry": (2, "f4"), "sum": (4, "f4")}[kind]
            target = c.texture(size, components, dtype=dtype)
            if kind == "geometry":
                target.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._framebuffers[key] = c.framebuffer([target], c.depth_renderbuffer(size))
        return self._framebuffers[key]

    def _draw_depth_map(self, vertices: FloatArray, clip: FloatArray, size: int) -> FloatArray:
        """Depth in [0, 1] along an orthographic `clip`, 1 where empty, row 0 at the bottom."""
        if vertices is not self._vertices:
            self._upload(vertices, np.ones((len(vertices), 2), np.float32))
        framebuffer = self._framebuffer("geometry", size, size)
        framebuffer.use()
        framebuffer.clear(1.0, 0.0, 0.0, 0.0, depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST)
        program = self._depth.program
        program["clip_from_head"].write(np.ascontiguousarray(clip.T).tobytes())
        row = 0.5 * clip[2]
        row[3] += 0.5
        program["depth_plane"].value = tuple(float(value) for value in row)
        self._depth.render()
        raw = np.frombuffer(framebuffer.read(components=1, dtype="f4"), np.float32)
        return raw.reshape(size, size)

    def _aim(self, program: Any, camera: Camera) -> None:
        clip = camera.clip_from_world(NEAR_M, FAR_M)
        program["clip_from_head"].write(np.ascontiguousarray(clip.T).tobytes())
        plane = (*camera.rotation[2], camera.translation_m[2])
        _set_uniforms(program, {"camera_m": tuple(camera.centre_m), "depth_plane": plane})

    def draw(self, camera: Camera) -> View:
        """Image, exact depth and mask of the pose."""
        geometry = self._draw_geometry(camera)
        image = self.draw_image(camera)
        depth, mask = _read_geometry(geometry)
        return View(image=image, depth_m=depth, mask=mask)

    def draw_image(self, camera: Camera) -> ByteArray:
        """The camera's sRGB image, supersampled, row 0 on top. uint8 ``[H, W, 3]``."""
        samples = self._draw_samples(camera)
        framebuffer = self._framebuffer("colour", camera.width, camera.height)
        framebuffer.use()
        self._context.enable_only(moderngl.NOTHING)
        samples.use(0)
        _set_uniforms(self._resolve.program, {"samples": 0, "side": SUPERSAMPLE})
        self._resolve.render(moderngl.TRIANGLES, vertices=3)
        wait_for_gpu(self._context)  # encoders may run meanwhile
        image: ByteArray = np.empty((camera.height, camera.width, 3), np.uint8)
        framebuffer.read_into(image, components=3, alignment=1)
        return image

    def _draw_geometry(self, camera: Camera) -> Any:
        framebuffer = self._framebuffer("geometry", camera.width, camera.height)
        framebuffer.use()
        framebuffer.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self._aim(self._depth.program, camera)
        self._depth.render()
        return framebuffer

    def _draw_samples(self, camera: Camera) -> Any:
        """Texture with the samples of the camera's image, row 0 at the bottom."""
        size = camera.width * SUPERSAMPLE, camera.height * SUPERSAMPLE
        framebuffer = self._framebuffer("colour", *size)
        framebuffer.use()
        framebuffer.clear(*(value / 255 for value in BACKGROUND), 1.0, depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self._colour.use(0)
        self._relief.use(1)
        for material, (first, count) in self._spans.items():
            array = self._shade[material]
            self._aim(array.program, camera)
            _set_uniforms(array.program, {"colour_map": 0, "relief_map": 1})
            array.render(vertices=count, first=first)
        return framebuffer.color_attachments[0]

    def unwrap(self, images: list[tuple[Camera, View]], size: int) -> tuple[ByteArray, BoolArray]:
        """Average texture: every image projected back onto the mesh, where its camera sees it.

        Args:
            images: Cameras with what they saw of the pose that is set now.
            size: Side of the texture, texels.

        Returns:
            sRGB texture, row 0 is v = 0, black where no camera looks; and where one does.
            uint8 ``[S, S, 3]``, bool ``[S, S]``.
        """
        c = self._context
        framebuffer = self._framebuffer("sum", size, size)
        framebuffer.clear(0.0, 0.0, 0.0, 0.0)
        program = self._unwrap.program
        _set_uniforms(program, {"image": 0, "geometry": 1, "tolerance_m": DEPTH_TOLERANCE_M})
        framebuffer.use()
        c.enable_only(moderngl.BLEND)
        c.blend_func = moderngl.ONE, moderngl.ONE
        for camera, view in images:
            self._aim(program, camera)
            for unit, texture in enumerate(self._upload_view(view)):
                texture.use(unit)
            self._unwrap.render()
        c.enable_only(moderngl.NOTHING)
        raw = np.frombuffer(framebuffer.read(components=4, dtype="f4"), np.float32)
        total = raw.reshape(size, size, 4)
        seen = total[..., 3] > 1e-4
        mean = total[..., :3] / np.maximum(total[..., 3:], 1e-4)
        result = np.where(seen[..., None], np.rint(255 * np.clip(mean, 0, 1)), 0)
        return result.astype(np.uint8), seen

    def _upload_view(self, view: View) -> tuple[Any, Any]:
        """A view's image, and its depth with its mask, as textures; row 0 at the bottom."""
        h, w = view.mask.shape
        if (w, h) not in self._view_textures:
            c = self._context
            pair = c.texture((w, h), 3), c.texture((w, h), 2, dtype="f4")
            pair[1].filter = (moderngl.NEAREST, moderngl.NEAREST)
            for texture in pair:
                texture.repeat_x = texture.repeat_y = False
            self._view_textures[w, h] = pair
        image, geometry = self._view_textures[w, h]
        both = np.empty((h, w, 2), np.float32)
        both[..., 0], both[..., 1] = view.depth_m[::-1], view.mask[::-1]
        image.write(np.ascontiguousarray(view.image[::-1]), alignment=1)
        geometry.write(both)
        return image, geometry


def _settle(targets: tuple[Any, ...]) -> None:
    """Make baked textures fit for filtering: empty texels take the nearest of a chart.

    Alpha of the last texture says where charts are; all have four bytes per texel.
    """
    size = targets[0].width
    texels = [np.frombuffer(target.read(), np.uint32) for target in targets]
    covered = texels[-1].view(np.uint8)[3::4].reshape(size, size) > 0
    row, column = distance_transform_edt(~covered, return_distances=False, return_indices=True)
    nearby = row.ravel() * size + column.ravel()
    for target, values in zip(targets, texels, strict=True):
        target.write(values[nearby])
        target.build_mipmaps(max_level=4)
        target.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        target.repeat_x = target.repeat_y = False


def _read_geometry(framebuffer: Any) -> tuple[FloatArray, ByteArray]:
    w, h = framebuffer.size
    both: FloatArray = np.empty((h, w, 2), np.float32)
    framebuffer.read_into(both, components=2, dtype="f4")
    return both[::-1, :, 0].copy(), np.rint(both[::-1, :, 1]).astype(np.uint8)


def _spans(materials: Int64Array) -> dict[int, tuple[int, int]]:
    """First index of each material's triangles, and how many indices they take."""
    names, first, count = np.unique(materials, return_index=True, return_counts=True)
    return {
        int(name): (3 * int(begin), 3 * int(number))
        for name, begin, number in zip(names, first, count, strict=True)
    }
