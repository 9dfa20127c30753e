"""Paint the appearance of a head over its chart: colour and relief of skin, hair, eyes, teeth.

A head's shadow on itself, which is how much of the dome, and of the key light, reaches each vertex,
is measured once per head by depth maps from many directions, at rest and at a few strong
expressions; a pose takes a mix of them. So it moves with the face at no cost per frame, without the
shadow of combinations that no single expression has.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import moderngl
import numpy as np
from scipy.ndimage import distance_transform_edt

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.bust import even_directions
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.rig.features import hair_coverage
from pica_core.capture.rig.head import RigHead
from pica_core.capture.triangles import mean_of_neighbours
from pica_core.files import packaged_json
from pica_core.gl import link_program
from pica_core.types import BoolArray, ByteArray, Float64Array, FloatArray, IntArray

KEY_DIRECTION = np.array([0.50, 0.55, 0.80]) / np.linalg.norm([0.50, 0.55, 0.80])
"""Must agree with shaders/stage.frag."""
KEY_SPREAD = 0.22
"""Half angle of the key light, radians: a softbox, so shadows have soft edges."""
SOFTENED = 2
"""How often a vertex takes half of its neighbours' light: no shadow is a saw of triangles."""
DOME_DIRECTIONS, KEY_DIRECTIONS = 28, 6
"""Directions of the dome's light, and within the key light's disc."""
DEPTH_MAP_SIZE = 192
SPAN_M = 0.42
"""Width of the depth maps, at least."""
BIAS_M, LIFT_M = 0.0022, 0.0015
POSES: tuple[tuple[str, ...], ...] = (
    ("jawOpen",),
    ("mouthFunnel",),
    ("mouthPucker",),
    ("mouthSmileLeft", "mouthSmileRight"),
    ("eyeBlinkLeft",),
    ("eyeBlinkRight",),
    ("browDownLeft", "browDownRight"),
    ("mouthUpperUpLeft", "mouthUpperUpRight", "mouthLowerDownLeft", "mouthLowerDownRight"),
)
"""Expressions whose shadow is measured; each is set to 1 as a whole."""


class Occlusion:
    """Shadow of one head as a function of its expression.

    Args:
        draw_depth: Draws a depth map of vertices along a clip matrix, so many texels wide.
        centre_y_m: Height that the depth maps are aimed at, head frame.
    """

    def __init__(
        self,
        head: RigHead,
        draw_depth: Callable[[FloatArray, FloatArray, int], FloatArray],
        centre_y_m: float,
    ) -> None:
        self._head, self._draw_depth = head, draw_depth
        self._span_m = max(SPAN_M, float(np.ptp(head.mesh.rest_m, axis=0).max()) + 0.05)
        self._centre_m = np.array([0.0, centre_y_m, 0.0])
        self._around = mean_of_neighbours(head.chart.faces, len(head.chart.source))
        self._poses = [p for p in POSES if all(name in head.names.drivers for name in p)]
        self._rest = self._measure(())
        changes = [self._measure(names) - self._rest for names in self._poses]
        self._changes = np.array(changes, np.float32).reshape(len(changes), self._rest.size)

    def _measure(self, shapes: tuple[str, ...]) -> FloatArray:
        arkit = np.zeros(NUM_ARKIT, np.float32)
        arkit[[ARKIT_INDEX[name] for name in shapes]] = 1.0
        vertices = self._head.vertices(arkit)
        normals = self._head.normals(vertices)
        sky, weight = np.zeros(len(vertices)), np.full(len(vertices), 1e-6)
        for direction in even_directions(DOME_DIRECTIONS):
            # Light from above counts more: a dome, not a fog.
            facing = np.maximum(normals @ direction, 0.0) * (0.65 + 0.35 * direction[1])
            sky += facing * self._lit(vertices, normals, direction)
            weight += facing
        disc = _softbox(KEY_DIRECTIONS)
        key = np.mean([self._lit(vertices, normals, direction) for direction in disc], axis=0)
        light = np.stack([sky / weight, key], 1)
        for _ in range(SOFTENED):
            light = 0.5 * (light + self._around @ light)
        return light.astype(np.float32)

    def _lit(self, vertices: FloatArray, normals: FloatArray, direction: Float64Array) -> BoolArray:
        """Which vertices see light from a direction (towards the light, unit length). ``[V]``."""
        up = np.array([0.0, 0.0, 1.0]) if abs(direction[1]) > 0.9 else np.array([0.0, 1.0, 0.0])
        right = np.cross(up, direction)
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(direction, right), -direction])
        axes /= 0.5 * self._span_m
        clip = np.eye(4, dtype=np.float32)
        clip[:3, :3] = axes
        clip[:3, 3] = -axes @ self._centre_m
        depth = self._draw_depth(vertices, clip, DEPTH_MAP_SIZE)
        lifted = vertices + LIFT_M * normals
        seen = lifted @ clip[:3, :3].T + clip[:3, 3]
        texel = ((seen[:, :2] * 0.5 + 0.5) * DEPTH_MAP_SIZE).astype(int)
        column, row = np.clip(texel, 0, DEPTH_MAP_SIZE - 1).T
        return 0.5 + 0.5 * seen[:, 2] <= depth[row, column] + BIAS_M / self._span_m

    def at(self, arkit: FloatArray) -> FloatArray:
        """Share of dome and key light that reaches each vertex. float32 ``[V, 2]``."""
        shares = [np.mean([arkit[ARKIT_INDEX[name]] for name in names]) for names in self._poses]
        weights = np.clip(np.array(shares, np.float32), 0, 1)
        mixed = self._rest + (weights @ self._changes).reshape(self._rest.shape)
        return np.clip(mixed, 0.0, 1.0)


def _softbox(count: int) -> Float64Array:
    """Even directions over the key light's disc. ``[n, 3]``."""
    a = np.cross(KEY_DIRECTION, [0.0, 1.0, 0.0])
    a /= np.linalg.norm(a)
    b = np.cross(KEY_DIRECTION, a)
    k = np.arange(count) + 0.5
    reach, spin = KEY_SPREAD * np.sqrt(k / count), np.pi * (1 + 5**0.5) * k
    disc = KEY_DIRECTION + reach[:, None] * (np.cos(spin)[:, None] * a + np.sin(spin)[:, None] * b)
    return disc / np.linalg.norm(disc, axis=1, keepdims=True)


def make_program(
    context: moderngl.Context, vertex: str, fragment: str, material: int | None = None
) -> Any:
    """Link two shaders of this package, the fragment shader with ``MATERIAL`` defined."""
    return link_program(
        context,
        vertex=_shader_text(f"{vertex}.vert"),
        fragment=_shader_text(f"{fragment}.frag", material),
    )


def _shader_text(name: str, material: int | None = None) -> str:
    """A shader with its includes resolved (one level)."""
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


def set_uniforms(program: Any, values: Mapping[str, Any]) -> None:
    """Set what the program has of these; the compiler drops what a shader does not need."""
    for name, value in values.items():
        if name in program:
            program[name].value = value


def vertex_array(
    context: moderngl.Context, program: Any, faces: Any, *buffers: tuple[Any, Mapping[str, int]]
) -> Any:
    """Triangles over float32 buffers, each with its layout; a program takes what it has of them."""
    content = []
    for buffer, layout in buffers:
        used = [name for name in layout if name in program]
        parts = [f"{n}f" if name in used else f"{n}x4" for name, n in layout.items()]
        if used:
            content.append((buffer, " ".join(parts), *used))
    return context.vertex_array(program, content, faces)


IRIS_RADIUS_M = 0.0060
"""11.7 mm across (Rüfer et al. 2005), a little more for eyeballs that are larger than life."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Growth:
    """Hair of a head by welded vertex.

    Attributes:
        hairs: Coverage of the scalp (0 at the hairline, 1 is 14 mm above), and direction
            of strands. float32 ``[P, 4]``.
        strand: On hair: along 0 to 1, across -1 to 1, number, length in metres. On teeth: 0, or 1
            where an arch ends in the dark. float32 ``[P, 4]``.
    """

    hairs: FloatArray
    strand: FloatArray


def split_parts(head: RigHead) -> IntArray:
    """Part of each split vertex: that of its triangles. ``[V]``."""
    part = np.zeros(len(head.chart.source), np.int32)
    of_face = head.features.part[head.chart.face_source]
    # Where parts share an island, the later part of the table wins.
    np.maximum.at(part, head.chart.faces, of_face[:, None])
    return part


def surface(head: RigHead, growth: Growth | None) -> FloatArray:
    """Four numbers for every split vertex; their meaning depends on the part. ``[V, 4]``."""
    f, mesh, source = head.features, head.mesh, head.chart.source
    rest = mesh.rest_m
    part = split_parts(head)
    local = np.zeros((len(source), 4), np.float32)
    skin = part == MATERIALS.index("skin")
    coverage = hair_coverage(rest)
    if f.regions["hair"].any():
        coverage = np.full(len(rest), -1.0)
    if growth is not None:
        coverage = growth.hairs[:, 0].astype(np.float64)
        locks = np.isin(part, [MATERIALS.index("hair"), MATERIALS.index("teeth")])
        local[locks] = growth.strand[source[locks]]
    columns = np.stack([f.lips, 1000 * f.eye_gap_m, coverage, f.above_eye], 1)
    local[skin] = columns[source[skin]]
    for eye in mesh.eyes:
        mine = np.isin(source, eye.vertices)
        local[mine, :3] = (rest[source[mine]] - eye.centre_m) / eye.radius_m
        local[mine, 3] = eye.side
    tongue = part == MATERIALS.index("tongue")
    if tongue.any():
        z = rest[source[tongue], 2]
        local[tongue, 0] = (z - z.min()) / max(float(np.ptp(z)), 1e-9)
    lining = part == MATERIALS.index("mouth_bag")
    if lining.any():
        z = rest[source[lining], 2]
        front = f.mouth.z.max() if f.mouth is not None else z.max()
        local[lining, 0] = 1000 * (front - z)
    return local


PAINT: dict[str, Any] = packaged_json("pica_core.capture.stage", "paint.json")
"""Linear colours and marks of the synthetic skin (chosen)."""
CORNER = {
    "vertex_uv": 2, "rest_m": 3, "local": 4, "source_uv": 2, "strand": 3,
    "tint": 3,
}  # fmt: skip
"""What the shader is told of each corner of a triangle, and in how many numbers."""


CREASED = 0.75
"""Alpha of the relief that the deepest creases take; `appearance.frag` and `stage.frag` have it,
too."""
CREASE_LEVEL = 9
"""Creases move vertices as a map of 256 texels has them, which are about as far apart."""


def paint(
    context: moderngl.Context,
    head: RigHead,
    albedo: dict[int, ByteArray],
    look: dict[str, Any],
    growth: Growth | None,
    size: int,
) -> tuple[Any, Any]:
    """Paint the textures ``colour_map`` and ``relief_map``, `size` texels wide; charts bleed.

    Source materials without an image in `albedo` are painted, as `look` says instead of `PAINT`.
    """
    targets = context.texture((size, size), 4), context.texture((size, size), 4)
    framebuffer = context.framebuffer(targets)
    framebuffer.use()
    context.enable_only(moderngl.NOTHING)
    framebuffer.clear(0, 0, 0, 0)
    # Each triangle brings its own corners: where islands were made here, a vertex may lie at
    # several places of the image.
    corner = head.chart.faces.ravel()
    rest = head.mesh.rest_m[head.chart.source]
    split = np.concatenate([head.chart.vertex_uv, rest, surface(head, growth)], 1)
    hairs, colours = split_strands(head, growth)[corner], head.mesh.colours
    tint = np.ones((len(corner), 3)) if colours is None else colours[head.chart.face_source]
    data = np.concatenate([split[corner], _source_uv(head), hairs, tint.reshape(-1, 3)], 1)
    corners = context.buffer(data.astype(np.float32).tobytes()), CORNER
    numbers = PAINT | look | _places(head) | {"has_growth": float(growth is not None)}
    part = split_parts(head)[head.chart.faces[:, 2]]
    material = head.mesh.material[head.chart.face_source]
    for painted, name in sorted(set(zip(part.tolist(), material.tolist(), strict=True))):
        chosen = np.flatnonzero((part == painted) & (material == name))
        mine = context.buffer((3 * chosen[:, None] + np.arange(3)).astype("i4").tobytes())
        image = albedo.get(name)
        if image is not None:
            picture = context.texture(image.shape[1::-1], 4, image.tobytes())
            picture.build_mipmaps()
            picture.use(0)
        program = make_program(context, "bake", "appearance", painted)
        set_uniforms(program, numbers | {"albedo": 0, "has_albedo": float(image is not None)})
        vertex_array(context, program, mine, corners).render()
    _settle(targets)
    return targets


def creases(relief: Any, uv: FloatArray) -> Float64Array:
    """How deep a crease each vertex lies in when skin folds, 0 to 1, of the painted relief, by
    texture coordinates. ``[V]``."""
    level = max(0, relief.width.bit_length() - CREASE_LEVEL)
    side = relief.width >> level
    depth = np.frombuffer(relief.read(level), np.uint8).reshape(side, side, 4)[..., 3] / 255
    column, row = np.clip((uv * side).astype(int), 0, side - 1).T
    return np.clip((1 - depth[row, column]) / CREASED, 0, 1)


def split_strands(head: RigHead, growth: Growth | None) -> FloatArray:
    """Direction of strands at each split vertex; 0 without growth. float32 ``[V, 3]``."""
    if growth is None:
        return np.zeros((len(head.chart.source), 3), np.float32)
    return growth.hairs[head.chart.source, 1:]


def _places(head: RigHead) -> dict[str, Any]:
    """Where features are, as `appearance.frag` names them; usual ones where there are none."""
    f, eyes = head.features, head.mesh.eyes
    eye = eyes[0].centre_m * [eyes[0].side, 1, 1] if eyes else np.array([0.031, 0.022, 0.074])
    radius = eyes[0].radius_m if eyes else 0.012
    return {
        "mouth_half": 1000 * f.mouth.half_m if f.mouth is not None else 23.0,
        "mouth_mm": 1000 * float(np.mean(f.mouth.y)) if f.mouth is not None else -45.0,
        "iris_reach": max(IRIS_RADIUS_M, 0.44 * radius) / radius,
        "eye_mm": tuple(1000 * eye),
        "brow_mm": 1000 * f.brow_y,
        "nose_mm": tuple(1000 * f.nose_tip),
    }


def _source_uv(head: RigHead) -> FloatArray:
    """The file's own texture coordinates of each triangle's corners. float32 ``[3F, 2]``."""
    mesh, chart = head.mesh, head.chart
    return mesh.uv[mesh.uv_faces[chart.face_source]].reshape(-1, 2).astype(np.float32)


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
