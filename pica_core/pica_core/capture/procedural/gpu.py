"""GL side of the built-in heads: paint an identity's appearance, pose it with its shadow."""

from typing import Any

import numpy as np

from pica_core.capture.procedural.heads import ProceduralHead
from pica_core.capture.procedural.shading import shade_eyes, soften
from pica_core.capture.stage.gpu import BAKE_SIZE, MeshRenderer
from pica_core.capture.stage.shadow import ShadowPlan
from pica_core.types import FloatArray


class ProceduralRenderer(MeshRenderer):
    """Draws one built-in head; `occlusion` False leaves out self-shadowing, which takes seconds."""

    def __init__(
        self, head: ProceduralHead, *, bake_size: int = BAKE_SIZE, occlusion: bool = True
    ) -> None:
        self.head = head
        shadows = ShadowPlan(
            dome_directions=32,
            key_directions=7,
            span_m=0.36,
            centre_m=(0.0, -0.01, 0.0),
            smooth=lambda shade: soften(shade, head.charts),
        )
        super().__init__(
            head,
            "stage",
            faces=head.faces,
            vertex_uv=head.vertex_uv,
            material=head.coordinates.material,
            moving={"tangent": 3},
            bake_size=bake_size,
            bleed=lambda reach: [1] * reach,
            shadows=shadows if occlusion else None,
        )

    def _paint(self) -> None:
        head, who = self.head, self.head.identity
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
        k = head.coordinates
        data = np.concatenate([head.vertex_uv, k.rest_m, k.local], 1).astype(np.float32)
        buffer = self._context.buffer(data.tobytes())
        vertices = buffer, {"vertex_uv": 2, "rest_m": 3, "local": 4}
        for material, (first, count) in self._spans.items():
            shaders = "bake", "appearance"
            self._paint_part(
                shaders, material, vertices, self._faces, numbers, vertices=count, first=first
            )

    def _more_moving(self, vertices: FloatArray, shade: FloatArray) -> tuple[FloatArray, ...]:
        """The direction of hair strands; lids shade the eyeballs."""
        shade_eyes(self.head, vertices, shade)
        hair = self.head.charts["hair"]
        grid = vertices[hair.span].reshape(*hair.shape, 3)
        tangent = np.zeros_like(vertices)
        tangent[hair.span] = np.asarray(np.gradient(grid, axis=0)).reshape(-1, 3)
        return (tangent,)
