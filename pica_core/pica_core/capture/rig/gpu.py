"""GL side of a head: paint its appearance, pose it with its shadow."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from pica_core.capture.rig.drawn import DrawnRig
from pica_core.capture.rig.features import LID_M
from pica_core.capture.rig.skin import IRIS_RADIUS_M, Albedo, Growth, split_parts, surface
from pica_core.capture.stage.gpu import BAKE_SIZE, MeshRenderer
from pica_core.capture.stage.shadow import ShadowPlan
from pica_core.types import FloatArray, Int64Array

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
SHADOW_SPAN_M = 0.42
"""Width of the depth maps for shadow, at least."""


class RigRenderer(MeshRenderer):
    """Draws one rig; source materials without an image in `albedo` are painted."""

    def __init__(
        self,
        head: DrawnRig,
        albedo: dict[int, Albedo] | None = None,
        look: dict[str, Any] | None = None,
        growth: Growth | None = None,
        *,
        bake_size: int = BAKE_SIZE,
        occlusion: bool = True,
    ) -> None:
        self.head, self._albedo = head, albedo or {}
        self._numbers, self._growth = PAINT | (look or {}), growth
        hairs = np.zeros((len(head.mesh.rest_m), 5), np.float32)
        self._hairs = (growth.hairs if growth is not None else hairs)[head.chart.source]
        self._lids = tuple(_lid_edges(head))
        self._material = split_parts(head).astype(np.float32)
        shadows = ShadowPlan(
            dome_directions=28,
            key_directions=6,
            span_m=max(SHADOW_SPAN_M, float(np.ptp(head.mesh.rest_m, axis=0).max()) + 0.05),
            centre_m=(0.0, -0.03 if growth is None else -0.11, 0.0),
            drivers=head.names.drivers,
        )
        super().__init__(
            head,
            faces=head.chart.faces,
            vertex_uv=head.chart.vertex_uv,
            material=self._material,
            bake_size=bake_size,
            shadows=shadows if occlusion else None,
        )

    def _paint(self) -> None:
        c, head = self._context, self.head
        f, mesh = head.features, head.mesh
        eyes = mesh.eyes
        eye = eyes[0].centre_m * [eyes[0].side, 1, 1] if eyes else np.array([0.031, 0.022, 0.074])
        radius = eyes[0].radius_m if eyes else 0.012
        mouth_y = float(np.mean(f.mouth.y)) if f.mouth is not None else -0.045
        numbers = {
            **self._numbers,
            "has_growth": float(self._growth is not None),
            "mouth_half": 1000 * f.mouth.half_m if f.mouth is not None else 23.0,
            "iris_reach": max(IRIS_RADIUS_M, 0.44 * radius) / radius,
            "eye_mm": tuple(1000 * eye),
            "brow_mm": 1000 * f.brow_y,
            "nose_mm": tuple(1000 * f.nose_tip),
            "mouth_mm": 1000 * mouth_y,
        }
        # Each triangle brings its own corners: where islands were made anew, a vertex may lie at
        # several places of the image.
        corner = head.chart.faces.ravel()
        rest = mesh.rest_m[head.chart.source]
        split = np.concatenate([head.chart.vertex_uv, rest, surface(head, self._growth)], 1)
        data = np.concatenate([split[corner], self._source_uv(), self._hairs[corner]], 1)
        buffer = c.buffer(data.astype(np.float32).tobytes())
        vertices = (
            buffer,
            {
                "vertex_uv": 2,
                "rest_m": 3,
                "local": 4,
                "source_uv": 2,
                "cover": 1,
                "strand": 3,
                "beard": 1,
            },
        )
        part = self._material[head.chart.faces[:, 2]]
        material = mesh.material[head.chart.face_source]
        for painted, name in sorted(set(zip(part.tolist(), material.tolist(), strict=True))):
            chosen = np.flatnonzero((part == painted) & (material == name))
            mine = c.buffer((3 * chosen[:, None] + np.arange(3)).astype("i4").tobytes())
            image = self._albedo.get(name)
            mirrored = 0.0, 0.0
            if image is not None:
                size, across, down = image.pixels.shape[1::-1], *image.wrap
                picture = c.texture(size, 3, image.pixels.tobytes(), alignment=1)
                picture.build_mipmaps()
                picture.repeat_x, picture.repeat_y = across == "repeat", down == "repeat"
                picture.use(0)
                mirrored = float(across == "mirror"), float(down == "mirror")
            values = {
                **numbers, "albedo": 0, "has_albedo": float(image is not None),
                "mirrored": mirrored,
            }  # fmt: skip
            shaders = "bake", "appearance"
            self._paint_part(shaders, int(painted), vertices, mine, values)

    def _source_uv(self) -> FloatArray:
        """The file's own texture coordinates of each triangle's corners. float32 ``[3F, 2]``."""
        mesh, chart = self.head.mesh, self.head.chart
        if mesh.uv is None or mesh.uv_faces is None:
            return np.zeros((3 * len(chart.faces), 2), np.float32)
        return mesh.uv[mesh.uv_faces[chart.face_source]].reshape(-1, 2).astype(np.float32)

    def _strands(self, vertices: FloatArray, shade: FloatArray) -> FloatArray:
        """Direction of strands; lids shade the eyeballs."""
        for eyeball, upper, lower in self._lids:
            x, y = vertices[eyeball, 0], vertices[eyeball, 1]
            above = _line(vertices[upper], x) - y
            below = y - _line(vertices[lower], x)
            light = (0.12 + 0.88 * _ramp(above, -0.0008, 0.0060)) * (
                0.60 + 0.40 * _ramp(below, -0.0006, 0.0026)
            )
            shade[eyeball] = light[:, None]
        return self._hairs[:, 1:4]


def _lid_edges(head: DrawnRig) -> Iterator[tuple[Int64Array, Int64Array, Int64Array]]:
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
    height: FloatArray = np.interp(x, points[order, 0], points[order, 1]).astype(np.float32)
    return height


def _ramp(value: FloatArray, low: float, high: float) -> FloatArray:
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)
