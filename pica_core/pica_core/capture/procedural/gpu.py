"""GL side of the built-in heads: bake an identity's appearance, pose it with its shadow."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
import numpy.typing as npt

from pica_core.capture.lighting.head_occlusion import Occlusion, shade_eyes
from pica_core.capture.procedural.heads import ProceduralHead
from pica_core.capture.stage.gpu import (
    BAKE_SIZE,
    DEPTH_TOLERANCE_M,
    MeshRenderer,
    View,
    attributes,
    set_uniforms,
    shader_text,
)
from pica_core.gl import link_program
from pica_core.types import FloatArray

__all__ = ["BAKE_SIZE", "DEPTH_TOLERANCE_M", "ProceduralRenderer", "View"]

MOVING = {"position_m": 3, "normal": 3, "tangent": 3, "occlusion": 2}
"""What moves with the face, by vertex; the tangent is that of strands."""


class ProceduralRenderer(MeshRenderer):
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
        self,
        head: ProceduralHead,
        context: Any = None,
        *,
        bake_size: int = BAKE_SIZE,
        occlusion: bool = True,
    ) -> None:
        self.head = head
        self._bake_size = bake_size
        super().__init__(
            context,
            "stage",
            faces=head.faces,
            vertex_uv=head.vertex_uv,
            material=head.coordinates.material,
            moving=MOVING,
        )
        self._occlusion = Occlusion(head, self._draw_depth_map) if occlusion else None

    def _bake(self) -> tuple[Any, Any]:
        c, head, who = self._context, self.head, self.head.identity
        size = self._bake_size
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
        buffer, layout = c.buffer(data.tobytes()), {"vertex_uv": 2, "rest_m": 3, "local": 4}
        targets = [c.texture((size, size), 4) for _ in range(2)]
        framebuffer = c.framebuffer(targets)
        framebuffer.use()
        c.enable_only(moderngl.NOTHING)
        framebuffer.clear(0, 0, 0, 0)
        for material, (first, count) in self._spans.items():
            program: Any = link_program(
                c,
                vertex=shader_text("bake.vert"),
                fragment=shader_text("appearance.frag", material),
            )
            set_uniforms(program, numbers)
            array = c.vertex_array(program, [attributes(program, buffer, layout)], self._faces)
            array.render(vertices=count, first=first)
        self._settle(targets, [1] * (2 * size // 256 + 2))
        del framebuffer, array, buffer
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
        hair = self.head.charts["hair"]
        grid = vertices[hair.span].reshape(*hair.shape, 3)
        tangent = np.zeros_like(vertices)
        tangent[hair.span] = np.asarray(np.gradient(grid, axis=0)).reshape(-1, 3)
        self._write_moving(vertices, self.head.normals(vertices), tangent, shade)
