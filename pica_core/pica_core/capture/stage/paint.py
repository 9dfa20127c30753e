"""Paint the appearance of a head over its chart: colour and relief of skin, hair, eyes, teeth."""

from typing import Any

import moderngl
import numpy as np
from scipy.ndimage import distance_transform_edt

from pica_core.capture.rig.drawn import DrawnRig
from pica_core.capture.rig.skin import IRIS_RADIUS_M, Albedo, Growth, split_parts, surface
from pica_core.capture.stage.programs import make_program, set_uniforms, vertex_array
from pica_core.types import FloatArray

PAINT: dict[str, Any] = {
    "seed": 3.0,
    "skin_rgb": (0.60, 0.36, 0.26),
    "lip_rgb": (0.46, 0.19, 0.165),
    "hair_rgb": (0.036, 0.023, 0.015),
    "iris_rgb": (0.16, 0.23, 0.26),
    "brow_rgb": (0.036, 0.023, 0.015),
    "cloth_rgb": (0.05, 0.07, 0.10),
    "cloth_knit": 0.25,
    "redness": 1.0,
    "age": 0.15,
    "freckles": 0.0,
    "moles": 0.5,
    "makeup": 0.0,
    "grey": 0.0,
    "stubble": 0.3,
    "brows": 1.0,
    "tooth_white": 0.5,
}
"""Linear colours and marks of the synthetic skin (chosen)."""
CORNER = {
    "vertex_uv": 2, "rest_m": 3, "local": 4, "source_uv": 2, "cover": 1, "strand": 3, "beard": 1,
}  # fmt: skip
"""What the shader is told of each corner of a triangle, and in how many numbers."""


def paint(
    context: moderngl.Context,
    head: DrawnRig,
    albedo: dict[int, Albedo],
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
    # Each triangle brings its own corners: where islands were made anew, a vertex may lie at
    # several places of the image.
    corner = head.chart.faces.ravel()
    rest = head.mesh.rest_m[head.chart.source]
    split = np.concatenate([head.chart.vertex_uv, rest, surface(head, growth)], 1)
    data = np.concatenate([split[corner], _source_uv(head), split_hairs(head, growth)[corner]], 1)
    corners = context.buffer(data.astype(np.float32).tobytes()), CORNER
    numbers = PAINT | look | _places(head) | {"has_growth": float(growth is not None)}
    part = split_parts(head)[head.chart.faces[:, 2]]
    material = head.mesh.material[head.chart.face_source]
    for painted, name in sorted(set(zip(part.tolist(), material.tolist(), strict=True))):
        chosen = np.flatnonzero((part == painted) & (material == name))
        mine = context.buffer((3 * chosen[:, None] + np.arange(3)).astype("i4").tobytes())
        image = albedo.get(name)
        mirrored = 0.0, 0.0
        if image is not None:
            pixels, across, down = image.pixels, *image.wrap
            picture = context.texture(pixels.shape[1::-1], 3, pixels.tobytes(), alignment=1)
            picture.build_mipmaps()
            picture.repeat_x, picture.repeat_y = across == "repeat", down == "repeat"
            picture.use(0)
            mirrored = float(across == "mirror"), float(down == "mirror")
        program = make_program(context, "bake", "appearance", painted)
        more = {"albedo": 0, "has_albedo": float(image is not None), "mirrored": mirrored}
        set_uniforms(program, numbers | more)
        vertex_array(context, program, mine, corners).render()
    _settle(targets)
    return targets


def split_hairs(head: DrawnRig, growth: Growth | None) -> FloatArray:
    """What `Growth.hairs` says of each split vertex; 0 without growth. float32 ``[V, 5]``."""
    if growth is None:
        return np.zeros((len(head.chart.source), 5), np.float32)
    return growth.hairs[head.chart.source]


def _places(head: DrawnRig) -> dict[str, Any]:
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


def _source_uv(head: DrawnRig) -> FloatArray:
    """The file's own texture coordinates of each triangle's corners. float32 ``[3F, 2]``."""
    mesh, chart = head.mesh, head.chart
    if mesh.uv is None or mesh.uv_faces is None:
        return np.zeros((3 * len(chart.faces), 2), np.float32)
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
