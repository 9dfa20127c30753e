"""The decoded maps of one slot on the GPU: a texture for each level and each kind of map, made when
its first map comes. Maps are uploaded, or drawn by a decoder in shaders.

A kind remembers which level came last and which one before it, so that a change of level can fade
in: `Placement.blend` mixes the two.
"""

from collections.abc import Mapping

import moderngl
import numpy as np

from pica_client.render.gpu_program import clamp
from pica_core.errors import ShapeError
from pica_core.types import FloatArray


class MapSeries:
    """One kind of map at every level.

    Args:
        rows: Of the maps that may come, by level; a level is their columns.
        components: Channels of the maps, 1 to 4.
        filtering: How shaders look them up: moderngl.NEAREST for texelFetch.

    32-bit floats: converting a map to 16 bits on the CPU takes 0.4 ms, uploading it as it is 0.02
    ms (llvmpipe).
    """

    def __init__(
        self, context: moderngl.Context, rows: Mapping[int, int], components: int, filtering: int
    ) -> None:
        self._context, self._rows = context, rows
        self._components, self._filtering = components, filtering
        self._textures: dict[int, moderngl.Texture] = {}
        self._targets: dict[int, moderngl.Framebuffer] = {}
        self.level = self.level_before = 0
        """Level of the map that came last, 0 if none came; and of the last map of another level
        before, or the same where there is none."""
        self.bytes_written = 0
        """What `write` has uploaded so far."""

    @property
    def newest(self) -> moderngl.Texture:
        """What came last. Not to be asked before the first map."""
        return self._textures[self.level]

    @property
    def before(self) -> moderngl.Texture:
        """The last map of the level before; the newest where there is none."""
        return self._textures[self.level_before]

    def check(self, array: FloatArray) -> None:
        """Raise a ShapeError for what is not float32, or of no level's shape."""
        shapes = [(rows, level, self._components) for level, rows in self._rows.items()]
        if array.shape not in shapes or array.dtype != np.float32:
            known = ", ".join(map(str, shapes))
            raise ShapeError(f"map is {array.dtype} {array.shape}; float32 {known} is needed")

    def write(self, array: FloatArray) -> None:
        """Upload a map that `check` has passed."""
        level = array.shape[1]
        self._begin(level, self._components)
        self._textures[level].write(np.ascontiguousarray(array))
        self.bytes_written += array.nbytes

    def target(self, level: int) -> moderngl.Framebuffer:
        """Where a map of a level is to be drawn, which counts as the newest. Four channels: GL does
        not draw into three floats."""
        self._begin(level, 4)
        if level not in self._targets:
            self._targets[level] = self._context.framebuffer([self._textures[level]])
        return self._targets[level]

    def read(self) -> FloatArray:
        """The newest map, for tests."""
        newest = self.newest
        values = np.frombuffer(newest.read(), np.float32)
        return values.reshape(newest.height, newest.width, newest.components)

    def _begin(self, level: int, components: int) -> None:
        if level != self.level:
            self.level, self.level_before = level, self.level or level
        if level not in self._textures:
            size = (level, self._rows[level])
            texture = self._context.texture(size, components, dtype="f4")
            self._textures[level] = clamp(texture, self._filtering)
