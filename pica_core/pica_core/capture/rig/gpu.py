"""GL side of a rig: paint its appearance, pose it with its shadow."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from pica_core.capture.rig.head import RigHead
from pica_core.capture.rig.skin import IRIS_RADIUS_M, split_parts, surface
from pica_core.capture.stage.gpu import BAKE_SIZE, MeshRenderer
from pica_core.capture.stage.shadow import ShadowPlan
from pica_core.types import ByteArray, FloatArray

PAINT: dict[str, Any] = {
    "seed": 3.0,
    "skin_rgb": (0.60, 0.36, 0.26),
    "lip_rgb": (0.46, 0.19, 0.165),
    "hair_rgb": (0.036, 0.023, 0.015),
    "iris_rgb": (0.16, 0.23, 0.26),
}
"""Linear colours of the synthetic skin (chosen)."""


class RigRenderer(MeshRenderer):
    """Draws one rig; source materials without an image in `albedo` are painted."""

    def __init__(
        self,
        head: RigHead,
        albedo: dict[int, ByteArray] | None = None,
        *,
        bake_size: int = BAKE_SIZE,
        occlusion: bool = True,
    ) -> None:
        self.head, self._albedo = head, albedo or {}
        self._material = split_parts(head).astype(np.float32)
        shadows = ShadowPlan(
            dome_directions=28,
            key_directions=6,
            span_m=0.42,
            centre_m=(0.0, -0.03, 0.0),
            drivers=head.names.drivers,
        )
        super().__init__(
            head,
            "rig_stage",
            faces=head.chart.faces,
            vertex_uv=head.chart.vertex_uv,
            material=self._material,
            moving={},
            bake_size=bake_size,
            bleed=_doubling,
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
            **PAINT,
            "iris_reach": max(IRIS_RADIUS_M, 0.44 * radius) / radius,
            "eye_mm": tuple(1000 * eye),
            "brow_mm": 1000 * f.brow_y,
            "nose_mm": tuple(1000 * f.nose_tip),
            "mouth_mm": 1000 * mouth_y,
        }
        rest = mesh.rest_m[head.chart.source]
        uv = self._source_uv()
        data = np.concatenate([head.chart.vertex_uv, rest, surface(head), uv], 1)
        buffer = c.buffer(data.astype(np.float32).tobytes())
        vertices = buffer, {"vertex_uv": 2, "rest_m": 3, "local": 4, "source_uv": 2}
        faces, part = head.chart.faces, self._material[head.chart.faces[:, 2]]
        material = mesh.material[head.chart.face_source]
        for painted, name in sorted(set(zip(part.tolist(), material.tolist(), strict=True))):
            mine = c.buffer(faces[(part == painted) & (material == name)].astype("i4").tobytes())
            image = self._albedo.get(name)
            if image is not None:
                picture = c.texture(image.shape[1::-1], 3, image.tobytes(), alignment=1)
                picture.build_mipmaps()
                picture.use(0)
            values = {**numbers, "albedo": 0, "has_albedo": float(image is not None)}
            shaders = "rig_bake", "rig_appearance"
            self._paint_part(shaders, int(painted), vertices, mine, values)

    def _source_uv(self) -> FloatArray:
        """The file's own texture coordinates of each split vertex. float32 ``[V, 2]``."""
        mesh, chart = self.head.mesh, self.head.chart
        result = np.zeros((len(chart.source), 2), np.float32)
        if mesh.uv is not None and mesh.uv_faces is not None:
            result[chart.faces] = mesh.uv[mesh.uv_faces[chart.face_source]]
            own = chart.faces[: len(mesh.faces)]  # a gutter's edge belongs to its own island
            result[own] = mesh.uv[mesh.uv_faces]
        return result

    def _more_moving(self, vertices: FloatArray, shade: FloatArray) -> tuple[FloatArray, ...]:
        return ()


def _doubling(reach: int) -> Iterator[int]:
    """Steps that together reach so far; what is filled is wide enough to be copied."""
    done = 0
    while done < reach:
        step = min(max(done // 2, 1), reach - done)
        yield step
        done += step
