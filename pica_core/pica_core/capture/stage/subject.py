"""What stands on the stage: a head that takes 52 values, is drawn, and unwraps textures.

The mesh keeps its topology, so buffers are made once.
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import numpy.typing as npt

from pica_core.camera import Camera
from pica_core.capture.rig.features import LID_M
from pica_core.capture.rig.gltf import read_rig
from pica_core.capture.rig.head import RigHead, make_rig
from pica_core.capture.rig.names import read_names
from pica_core.capture.rig.source import RigSource
from pica_core.capture.stage.flesh import STILL, Flesh
from pica_core.capture.stage.paint import (
    Growth,
    Occlusion,
    creases,
    make_program,
    paint,
    set_uniforms,
    split_parts,
    split_strands,
    vertex_array,
)
from pica_core.gl import create_context, wait_for_gpu
from pica_core.types import ByteArray, Float64Array, FloatArray, Int64Array

BAKE_SIZE = 2048
"""Side of the appearance textures: 8 texels per position-map texel, about 0.1 mm on the face."""
SUPERSAMPLE = 2
"""Samples per pixel along each axis."""
BACKGROUND = (92, 97, 104)
"""sRGB of the empty stage."""
NEAR_M, FAR_M = 0.05, 6.0
DEPTH_TOLERANCE_M = 0.0015
"""How far behind the nearest surface a texel may lie and still count as seen."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class View:
    """What one camera sees.

    Attributes:
        image: sRGB, row 0 on top. uint8 ``[H, W, 3]``.
        depth_m: Distance along the camera axis at pixel centres, 0 where empty. float32 ``[H, W]``.
    """

    image: ByteArray
    depth_m: FloatArray


class Subject:
    """A head on the stage; one thread owns it.

    Its GL context is made with the first pose, which is a `GraphicsError` where there can be none.

    Args:
        about: At least ``source`` and ``licence`` of what `capture.json` says of the head.
        albedo: Images by the source's material; others are painted.
        look: Colours and marks, as `paint.PAINT` names them, instead of those there.
        growth: Hair that the mesh has, if it has some.
        bake_size: Side of the appearance textures, texels.
        self_shadow: False leaves out shadow of the face on itself, which takes seconds to measure.

    Attributes:
        about: What `capture.json` says of the head; JSON values.
        topology: The mesh that `pose` moves.
    """

    def __init__(
        self,
        head: RigHead,
        about: dict[str, Any],
        *,
        albedo: dict[int, ByteArray] | None = None,
        look: dict[str, Any] | None = None,
        growth: Growth | None = None,
        bake_size: int = BAKE_SIZE,
        self_shadow: bool = True,
    ) -> None:
        self.head, self.name, self.topology = head, head.name, head.topology
        self.about = {"head": head.name, **about}
        self._albedo, self._look, self._growth = albedo or {}, look or {}, growth
        self._bake_size, self._self_shadow = bake_size, self_shadow
        self._context: Any = None
        self._flesh: Flesh | None = None
        self._strands = split_strands(head, growth)
        self._lids = tuple(_lid_edges(head))

    def _open(self) -> None:
        """Make a context, with everything that no pose changes."""
        self._context = c = create_context()
        head = self.head
        self._framebuffers: dict[tuple[str, int, int], Any] = {}
        self._layout = {"position_m": 3, "normal": 3, "occlusion": 2, "tangent": 3, "folded": 1}
        faces = head.chart.faces
        by_face = split_parts(head)[faces[:, 2]]  # the last vertex of a triangle counts
        order = np.argsort(by_face, kind="stable")
        self._faces = c.buffer(np.ascontiguousarray(faces[order], np.int32).tobytes())
        names, first, count = np.unique(by_face[order], return_index=True, return_counts=True)
        uv = head.chart.vertex_uv.astype(np.float32)
        self._static = c.buffer(uv.tobytes())
        self._unfolded = np.zeros(len(uv), np.float32)
        stride = 4 * sum(self._layout.values())
        self._moving = c.buffer(reserve=len(uv) * stride, dynamic=True)
        self._shade = [
            (self._over_mesh("stage", int(name)), {"first": 3 * int(at), "vertices": 3 * int(n)})
            for name, at, n in zip(names, first, count, strict=True)
        ]
        self._depth = self._over_mesh("depth")
        self._unwrap = self._over_mesh("unwrap")
        self._resolve = c.vertex_array(make_program(c, "resolve", "resolve"), [])
        self._vertices: FloatArray = np.zeros((0, 3), np.float32)
        self._colour, self._relief = paint(
            c, head, self._albedo, self._look, self._growth, self._bake_size
        )
        c.gc()
        if self._flesh is not None:
            self._flesh.creases = creases(self._relief, uv)
        self._occlusion: Occlusion | None = None
        if self._self_shadow:
            centre_y_m = -0.03 if self._growth is None else -0.11
            self._occlusion = Occlusion(head, self._draw_depth_map, centre_y_m)

    def enliven(self) -> None:
        """Give it flesh: from now on poses fold, slide and swing."""
        self._flesh = Flesh(self.head, self._growth)

    def pose(self, arkit: npt.ArrayLike, sway: Float64Array = STILL) -> FloatArray:
        """Pose for the draws that follow; returns vertices, head frame, metres ``[V, 3]``.

        Args:
            sway: What inertia does to hair and tongue, as `flesh.sway`; without flesh nothing.
        """
        if self._context is None:
            self._open()
        vertices, values = self.head.vertices(arkit), np.asarray(arkit, np.float32)
        shade = np.ones((len(vertices), 2), np.float32)
        if self._occlusion is not None:
            shade = self._occlusion.at(values)
        folded = self._unfolded
        if self._flesh is not None:
            folded = self._flesh.move(vertices, values, sway)
        self._upload(vertices, shade, folded)
        return vertices

    def _upload(self, vertices: FloatArray, shade: FloatArray, folded: FloatArray) -> None:
        for eyeball, upper, lower in self._lids:  # lids shade the eyeballs
            x, y = vertices[eyeball, 0], vertices[eyeball, 1]
            above = _line(vertices[upper], x) - y
            below = y - _line(vertices[lower], x)
            light = (0.12 + 0.88 * _ramp(above, -0.0008, 0.0060)) * (
                0.60 + 0.40 * _ramp(below, -0.0006, 0.0026)
            )
            shade[eyeball] = light[:, None]
        values = vertices, self.head.normals(vertices), shade, self._strands, folded[:, None]
        self._moving.write(np.concatenate(values, 1, dtype=np.float32, casting="same_kind"))
        self._vertices = vertices

    def release(self) -> None:
        """Give back what drawing needed."""
        if self._context is None:
            return
        self._framebuffers.clear()
        self._context.gc()
        self._context.release()
        self._context = None

    def _over_mesh(self, shader: str, material: int | None = None) -> Any:
        """The mesh with a program that takes what it wants of the vertices."""
        program = make_program(self._context, shader, shader, material)
        static = self._static, {"vertex_uv": 2}
        moving = self._moving, self._layout
        return vertex_array(self._context, program, self._faces, moving, static)

    def _framebuffer(self, kind: str, width: int, height: int) -> Any:
        key = (kind, width, height)
        if key not in self._framebuffers:
            c, size = self._context, (width, height)
            components, dtype = {"colour": (4, "f1"), "geometry": (1, "f4"), "sum": (4, "f4")}[kind]
            target = c.texture(size, components, dtype=dtype)
            target.repeat_x = target.repeat_y = False
            if kind == "geometry":
                target.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._framebuffers[key] = c.framebuffer([target], c.depth_renderbuffer(size))
        return self._framebuffers[key]

    def _draw_depth_map(self, vertices: FloatArray, clip: FloatArray, size: int) -> FloatArray:
        """Depth in [0, 1] along an orthographic `clip`, 1 where empty, row 0 at the bottom."""
        if vertices is not self._vertices:
            self._upload(vertices, np.ones((len(vertices), 2), np.float32), self._unfolded)
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
        set_uniforms(program, {"camera_m": tuple(camera.centre_m), "depth_plane": plane})

    def draw(self, camera: Camera) -> View:
        """Image and exact depth of the pose, seen by a camera in head axes."""
        framebuffer = self._framebuffer("geometry", camera.width, camera.height)
        framebuffer.use()
        framebuffer.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self._aim(self._depth.program, camera)
        self._depth.render()
        image = self._draw_image(camera)
        depth_m: FloatArray = np.empty((camera.height, camera.width), np.float32)
        framebuffer.read_into(depth_m, components=1, dtype="f4")
        return View(image=image, depth_m=depth_m[::-1].copy())

    def _draw_image(self, camera: Camera) -> ByteArray:
        """The camera's sRGB image, supersampled, row 0 on top. uint8 ``[H, W, 3]``."""
        width, height, c = camera.width, camera.height, self._context
        samples = self._framebuffer("colour", width * SUPERSAMPLE, height * SUPERSAMPLE)
        samples.use()
        samples.clear(*(value / 255 for value in BACKGROUND), 1.0, depth=1.0)
        c.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self._colour.use(0)
        self._relief.use(1)
        for array, span in self._shade:
            self._aim(array.program, camera)
            set_uniforms(array.program, {"colour_map": 0, "relief_map": 1})
            array.render(**span)
        framebuffer = self._framebuffer("colour", width, height)
        framebuffer.use()
        c.enable_only(moderngl.NOTHING)
        samples.color_attachments[0].use(0)
        set_uniforms(self._resolve.program, {"samples": 0, "side": SUPERSAMPLE})
        self._resolve.render(moderngl.TRIANGLES, vertices=3)
        wait_for_gpu(c)  # encoders may run meanwhile
        image: ByteArray = np.empty((height, width, 3), np.uint8)
        framebuffer.read_into(image, components=3, alignment=1)
        return image

    def photograph(self, cameras: Sequence[Camera], size: int) -> tuple[list[View], ByteArray]:
        """What cameras in head axes see of the pose, and the average texture: every image projected
        back onto the mesh, where its camera sees it.

        Args:
            size: Side of the texture, texels.

        Returns:
            Views; and the sRGB texture, row 0 is v = 0, black where no camera looks. uint8
            ``[S, S, 3]``.
        """
        c, views = self._context, []
        total = self._framebuffer("sum", size, size)
        total.clear(0.0, 0.0, 0.0, 0.0)
        program = self._unwrap.program
        set_uniforms(program, {"image": 0, "seen_m": 1, "tolerance_m": DEPTH_TOLERANCE_M})
        for camera in cameras:
            views.append(self.draw(camera))
            for unit, kind in enumerate(("colour", "geometry")):
                self._framebuffer(kind, camera.width, camera.height).color_attachments[0].use(unit)
            total.use()
            c.enable_only(moderngl.BLEND)
            c.blend_func = moderngl.ONE, moderngl.ONE
            self._aim(program, camera)
            self._unwrap.render()
        c.enable_only(moderngl.NOTHING)
        raw = np.frombuffer(total.read(components=4, dtype="f4"), np.float32)
        sums = raw.reshape(size, size, 4)
        seen = sums[..., 3] > 1e-4
        mean = sums[..., :3] / np.maximum(sums[..., 3:], 1e-4)
        texture = np.where(seen[..., None], np.rint(255 * np.clip(mean, 0, 1)), 0)
        return views, texture.astype(np.uint8)


def _lid_edges(head: RigHead) -> Iterator[tuple[Int64Array, Int64Array, Int64Array]]:
    """Find split vertices of each eyeball that has lids, of its upper and of its lower lid."""
    f, rest, source = head.features, head.mesh.rest_m, head.chart.source
    for eye in head.mesh.eyes:
        near = f.regions["lids"] & (f.eye_gap_m < LID_M)
        near &= np.abs(rest[:, 0] - eye.centre_m[0]) < 1.3 * eye.radius_m
        edges = [np.flatnonzero((near & above)[source]) for above in (f.above_eye, ~f.above_eye)]
        if min(map(len, edges)) > 3:
            yield np.flatnonzero(np.isin(source, eye.vertices)), edges[0], edges[1]


def _line(points: FloatArray, x: FloatArray) -> FloatArray:
    """Height of a lid's edge, through its points ``[n, 3]``, at `x`. ``[V]``."""
    order = np.argsort(points[:, 0])
    return np.interp(x, points[order, 0], points[order, 1]).astype(np.float32)


def _ramp(value: FloatArray, low: float, high: float) -> FloatArray:
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


class RigSubject(Subject):
    """A rig on the stage, from a glTF file, whose further options are those of `Subject`.

    `table` is the user's table of names.

    Raises:
        CaptureError: Anything that is wrong with the files.
    """

    def __init__(self, path: Path, table: Path | None = None, **options: Any) -> None:
        names = read_names(table) if table is not None else None
        source = read_rig(path)
        head = make_rig(source, names)
        about = describe_rig(path, source, head)
        super().__init__(head, about, albedo=source.images, **options)


def describe_rig(path: Path, source: RigSource, head: RigHead) -> dict[str, Any]:
    """Source, rights, names, unit and parts."""
    mesh = head.mesh
    return {
        "source": f"rendered from the rig {path.name}",
        "licence": source.copyright or "that of the rig; its file does not say",
        "rig": {
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
            "unit": mesh.frame.unit,
            "guessed": list(mesh.frame.guessed),
            "mapped": list(head.names.mapped),
            "missing": list(head.names.missing),
            "ignored": list(head.names.ignored),
            "left_out_materials": list(mesh.dropped),
            "smaller_images": list(source.smaller_images),
            "triangles_with_new_coordinates": head.mended,
        },
    }
