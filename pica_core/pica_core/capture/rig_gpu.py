"""GL side of a rig: bake its appearance, draw images and depth, unwrap textures.

As `gpu.StageRenderer` does it for the built-in heads, with a surface that knows nothing of their
charts. One thread owns a `RigRenderer`.
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
import numpy.typing as npt

from pica_core.camera import Camera
from pica_core.capture.gpu import (
    BACKGROUND,
    DEPTH_TOLERANCE_M,
    FAR_M,
    NEAR_M,
    SUPERSAMPLE,
    View,
    shader_text,
)
from pica_core.capture.rig_head import RigHead
from pica_core.capture.rig_occlusion import RigOcclusion
from pica_core.capture.rig_skin import IRIS_RADIUS_M, split_parts, surface
from pica_core.gl import create_context, link_program

FloatArray = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]

BAKE_SIZE = 2048
"""Side of the appearance textures, texels, unless images ask for others."""
LOOKS: dict[str, Any] = {
    "seed": 3.0,
    "skin_rgb": (0.60, 0.36, 0.26),
    "lip_rgb": (0.46, 0.19, 0.165),
    "hair_rgb": (0.036, 0.023, 0.015),
    "iris_rgb": (0.16, 0.23, 0.26),
}
"""Linear colours of the synthetic skin (chosen)."""


class RigRenderer:
    """Draws one rig.

    Args:
        head: The rig.
        albedo: Base colour images by source material; what has none is painted.
        bake_size: Side of the appearance textures, texels.
        occlusion: False leaves out self-shadowing, which takes seconds to measure.

    Raises:
        GraphicsError: No GL context.
    """

    def __init__(
        self,
        head: RigHead,
        albedo: dict[int, ByteArray] | None = None,
        *,
        bake_size: int = BAKE_SIZE,
        occlusion: bool = True,
    ) -> None:
        self.head = head
        self._context = c = create_context()
        self._framebuffers: dict[tuple[str, int, int], Any] = {}
        self._programs: dict[str, Any] = {
            name: link_program(
                c, vertex=shader_text(f"{name}.vert"), fragment=shader_text(f"{name}.frag")
            )
            for name in ("rig_stage", "depth", "unwrap")
        }
        self._faces = c.buffer(np.ascontiguousarray(head.chart.faces, np.int32).tobytes())
        self._material = split_parts(head).astype(np.float32)[:, None]
        static = np.concatenate([head.chart.vertex_uv, self._material], 1)
        self._static = c.buffer(static.astype(np.float32).tobytes())
        self._moving = c.buffer(reserve=head.num_vertices * 8 * 4, dynamic=True)
        layouts = (
            ("rig_stage", "3f 3f 2f", ["position_m", "normal", "occlusion"], "2f 1f",
             ["vertex_uv", "material"]),
            ("depth", "3f 3x4 2x4", ["position_m"], "2x4 1f", ["material"]),
            ("unwrap", "3f 3f 2x4", ["position_m", "normal"], "2f 1x4", ["vertex_uv"]),
        )  # fmt: skip
        self._arrays = {
            name: c.vertex_array(
                self._programs[name],
                [(self._moving, moving, *names), (self._static, fixed, *fixed_names)],
                self._faces,
            )
            for name, moving, names, fixed, fixed_names in layouts
        }
        self._colour, self._relief = self._bake(bake_size, albedo or {})
        self._vertices: FloatArray = np.zeros((0, 3), np.float32)
        self._occlusion = RigOcclusion(head, self._draw_depth_map) if occlusion else None

    def release(self) -> None:
        """Give the context back; the renderer is useless afterwards."""
        self._framebuffers.clear()
        self._context.gc()
        self._context.release()

    def _bake(self, size: int, albedo: dict[int, ByteArray]) -> tuple[Any, Any]:
        c, head = self._context, self.head
        program: Any = link_program(
            c, vertex=shader_text("rig_bake.vert"), fragment=shader_text("rig_appearance.frag")
        )
        f, mesh = head.features, head.mesh
        eyes = mesh.eyes
        eye = eyes[0].centre_m * [eyes[0].side, 1, 1] if eyes else np.array([0.031, 0.022, 0.074])
        radius = eyes[0].radius_m if eyes else 0.012
        mouth_y = float(np.mean(f.mouth.y)) if f.mouth is not None else -0.045
        numbers = {
            **LOOKS,
            "iris_reach": max(IRIS_RADIUS_M, 0.44 * radius) / radius,
            "eye_mm": tuple(1000 * eye),
            "brow_mm": 1000 * f.brow_y,
            "nose_mm": tuple(1000 * f.nose_tip),
            "mouth_mm": 1000 * mouth_y,
        }
        for name, value in numbers.items():
            program[name].value = value
        uv = self._source_uv()
        rest = mesh.rest_m[head.chart.source]
        data = np.concatenate([head.chart.vertex_uv, rest, surface(head), uv, self._material], 1)
        buffer = c.buffer(data.astype(np.float32).tobytes())
        names = ("vertex_uv", "rest_m", "local", "source_uv", "material")
        targets = [c.texture((size, size), 4) for _ in range(2)]
        framebuffer = c.framebuffer(targets)
        framebuffer.use()
        c.enable_only(moderngl.NOTHING)
        framebuffer.clear(0, 0, 0, 0)
        for material in np.unique(mesh.material):
            mine = mesh.material[head.chart.face_source] == material
            faces = c.buffer(head.chart.faces[mine].astype("i4").tobytes())
            array = c.vertex_array(program, [(buffer, "2f 3f 4f 2f 1f", *names)], faces)
            image = albedo.get(int(material))
            program["has_albedo"].value = 0.0 if image is None else 1.0
            if image is not None:
                picture = c.texture(image.shape[1::-1], 3, image.tobytes(), alignment=1)
                picture.build_mipmaps()
                picture.use(0)
                program["albedo"].value = 0
            array.render()
        pixels = [np.frombuffer(t.read(), np.uint8).reshape(size, size, 4) for t in targets]
        covered = pixels[1][..., 3] > 0
        for target, texels in zip(targets, pixels, strict=True):
            target.write(_bleed(texels.copy(), covered, 2 * size // 256 + 2).tobytes())
            target.build_mipmaps(max_level=4)
            target.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
            target.repeat_x = target.repeat_y = False
        del framebuffer, buffer
        c.gc()
        return targets[0], targets[1]

    def _source_uv(self) -> FloatArray:
        """The file's own texture coordinates of each split vertex. float32 ``[V, 2]``."""
        mesh, chart = self.head.mesh, self.head.chart
        result = np.zeros((len(chart.source), 2), np.float32)
        if mesh.uv is not None and mesh.uv_faces is not None:
            result[chart.faces] = mesh.uv[mesh.uv_faces[chart.face_source]]
            own = chart.faces[: len(mesh.faces)]  # a skirt's edge belongs to its own island
            result[own] = mesh.uv[mesh.uv_faces]
        return result

    def pose(self, arkit: npt.ArrayLike) -> FloatArray:
        """Pose the rig for the draws that follow; returns its vertices, metres ``[V, 3]``."""
        vertices = self.head.vertices(arkit)
        shade = np.ones((len(vertices), 2), np.float32)
        if self._occlusion is not None:
            shade = self._occlusion.at(np.asarray(arkit, np.float32))
        self._upload(vertices, shade)
        return vertices

    def _upload(self, vertices: FloatArray, shade: FloatArray) -> None:
        data = np.concatenate([vertices, self.head.normals(vertices), shade], 1)
        self._moving.write(data.astype(np.float32).tobytes())
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

    def _aim(self, program: Any, camera: Camera) -> None:
        clip = camera.clip_from_world(NEAR_M, FAR_M)
        program["clip_from_head"].write(np.ascontiguousarray(clip.T).tobytes())
        if "camera_m" in program:
            program["camera_m"].value = tuple(camera.centre_m)
        if "depth_plane" in program:
            program["depth_plane"].value = (*camera.rotation[2], camera.translation_m[2])

    def draw(self, camera: Camera) -> View:
        """Image, exact depth and mask of the posed rig."""
        w, h, s = camera.width, camera.height, SUPERSAMPLE
        framebuffer = self._framebuffer("geometry", w, h)
        framebuffer.use()
        framebuffer.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self._aim(self._programs["depth"], camera)
        self._arrays["depth"].render()
        raw = np.frombuffer(framebuffer.read(components=2, dtype="f4"), np.float32)
        both = raw.reshape(h, w, 2)[::-1]
        framebuffer = self._framebuffer("colour", w * s, h * s)
        framebuffer.use()
        framebuffer.clear(*(value / 255 for value in BACKGROUND), 1.0, depth=1.0)
        program = self._programs["rig_stage"]
        self._aim(program, camera)
        program["colour_map"].value, program["relief_map"].value = 0, 1
        self._colour.use(0)
        self._relief.use(1)
        self._arrays["rig_stage"].render()
        fine = np.frombuffer(framebuffer.read(components=4), np.uint8).reshape(h, s, w, s, 4)
        total = fine.astype(np.uint16).sum((1, 3), dtype=np.uint16)
        mean = ((total + s * s // 2) // (s * s)).astype(np.uint8)
        return View(
            image=np.ascontiguousarray(mean[::-1, :, :3]),
            depth_m=both[..., 0].copy(),
            mask=np.rint(both[..., 1]).astype(np.uint8),
        )

    def unwrap(
        self, images: list[tuple[Camera, View]], size: int
    ) -> tuple[ByteArray, npt.NDArray[np.bool_]]:
        """Average texture of the pose, from what cameras saw of it.

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
            w, h = camera.width, camera.height
            image = c.texture((w, h), 3, view.image[::-1].tobytes(), alignment=1)
            both = np.stack([view.depth_m[::-1], view.mask[::-1].astype(np.float32)], -1)
            geometry = c.texture((w, h), 2, both.tobytes(), dtype="f4")
            geometry.filter = (moderngl.NEAREST, moderngl.NEAREST)
            for texture in (image, geometry):
                texture.repeat_x = texture.repeat_y = False
            framebuffer.use()
            c.enable_only(moderngl.BLEND)
            c.blend_func = moderngl.ONE, moderngl.ONE
            self._aim(program, camera)
            image.use(0)
            geometry.use(1)
            self._arrays["unwrap"].render()
            del image, geometry, texture
            c.gc()
        c.enable_only(moderngl.NOTHING)
        raw = np.frombuffer(framebuffer.read(components=4, dtype="f4"), np.float32)
        total = raw.reshape(size, size, 4)
        seen = total[..., 3] > 1e-4
        mean = total[..., :3] / np.maximum(total[..., 3:], 1e-4)
        result = np.where(seen[..., None], np.rint(255 * np.clip(mean, 0, 1)), 0)
        return result.astype(np.uint8), seen


def _bleed(texels: ByteArray, covered: npt.NDArray[np.bool_], reach: int) -> ByteArray:
    """Let islands grow into the empty texels around them, so that filtering finds no background."""
    filled = covered.copy()
    done = 0
    while done < reach:
        step = min(max(done // 2, 1), reach - done)  # what is filled is wide enough to be copied
        for axis, shift in ((0, step), (0, -step), (1, step), (1, -step)):
            moved = np.roll(filled, shift, axis)
            take = moved & ~filled
            texels[take] = np.roll(texels, shift, axis)[take]
            filled |= take
        done += step
    return texels
