"""The decoded maps of one head on the GPU, by level: uploaded, or drawn there by a decoder in
shaders.
"""

from collections.abc import Mapping

import moderngl
import numpy as np

from pica_client.render.gpu_program import clamp
from pica_core.avatar.spec import EXPRESSION_CHANNELS, POSITION_CHANNELS
from pica_core.errors import ShapeError
from pica_core.types import FloatArray

POSITIONS, EXPRESSIONS = 0, 1
"""The two kinds of maps."""


class HeadMaps:
    """Positions and expressions of one head.

    Args:
        rows: Of its position maps, by level. A level is the columns of both maps, and the rows of
            expression maps.

    Attributes:
        level: That of the maps that came last; 0 before both are there.

    32-bit floats: converting a map to 16 bits on the CPU takes 0.4 ms, uploading it as it is 0.02
    ms (llvmpipe).
    """

    def __init__(self, context: moderngl.Context, rows: Mapping[int, int]) -> None:
        self._context = context
        self._shapes = (
            {level: (count, level, POSITION_CHANNELS) for level, count in rows.items()},
            {level: (level, level, EXPRESSION_CHANNELS) for level in rows},
        )
        self._textures: dict[tuple[int, int], moderngl.Texture] = {}
        self._targets: tuple[moderngl.Framebuffer, moderngl.Framebuffer] | None = None
        self.level = 0

    @property
    def newest(self) -> tuple[moderngl.Texture, moderngl.Texture]:
        """Positions and expressions of `level`."""
        return self._textures[self.level, POSITIONS], self._textures[self.level, EXPRESSIONS]

    def write(self, *arrays: FloatArray | None) -> None:
        """Upload positions and expressions of one level, or one of the two.

        Raises:
            ShapeError: What is not float32, or of no level's shape; nothing is changed.
        """
        for shapes, array in zip(self._shapes, arrays, strict=True):
            if array is None or (array.shape in shapes.values() and array.dtype == np.float32):
                continue
            known = ", ".join(map(str, shapes.values()))
            raise ShapeError(f"map is {array.dtype} {array.shape}; float32 {known} is needed")
        for kind, array in enumerate(arrays):
            if array is not None:
                _, level, components = array.shape
                texture = self._texture(level, kind, components)
                texture.write(np.ascontiguousarray(array))
                self._show(level)

    def targets(self) -> tuple[moderngl.Framebuffer, moderngl.Framebuffer]:
        """Where both maps of the full level, four channels a texel, are to be drawn now."""
        self.level = max(self._shapes[POSITIONS])
        if self._targets is None:
            positions, expressions = (
                self._context.framebuffer([self._texture(self.level, kind, 4)])
                for kind in (POSITIONS, EXPRESSIONS)
            )
            self._targets = positions, expressions
        return self._targets

    def _texture(self, level: int, kind: int, components: int) -> moderngl.Texture:
        key = level, kind
        if key not in self._textures:
            size = level, self._shapes[kind][level][0]
            texture = self._context.texture(size, components, dtype="f4")
            # Positions are looked up by texelFetch.
            clamp(texture, moderngl.NEAREST if kind == POSITIONS else moderngl.LINEAR)
            self._textures[key] = texture
        return self._textures[key]

    def _show(self, level: int) -> None:
        """Take a level as the newest if both of its maps are there."""
        if {(level, POSITIONS), (level, EXPRESSIONS)} <= set(self._textures):
            self.level = level
