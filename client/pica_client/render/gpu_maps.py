"""The decoded maps of one slot on the GPU: a texture for each level and each kind of map, all made
when the avatar comes, so that a frame allocates nothing.

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
        self._textures = {
            level: clamp(context.texture((level, count), components, dtype="f4"), filtering)
            for level, count in rows.items()
        }
        self._components = components
        self.level = self.level_before = 0
        """Level of the map that came last, 0 if none came; and of the last map of another level
        before, or the same where there is none."""
        self.bytes_written = 0
        """What `write` has uploaded so far."""

    @property
    def newest(self) -> moderngl.Texture:
        """What was written last. Not to be asked before the first `write`."""
        return self._textures[self.level]

    @property
    def before(self) -> moderngl.Texture:
        """The last map of the level before; the newest where there is none."""
        return self._textures[self.level_before]

    def check(self, array: FloatArray) -> None:
        """Raise a ShapeError for what is not float32, or of no level's shape."""
        shapes = [(t.height, t.width, self._components) for t in self._textures.values()]
        if array.shape not in shapes or array.dtype != np.float32:
            known = ", ".join(map(str, shapes))
            raise ShapeError(f"map is {array.dtype} {array.shape}; float32 {known} is needed")

    def write(self, array: FloatArray) -> None:
        """Upload a map that `check` has passed."""
        level = array.shape[1]
        if level != self.level:
            self.level, self.level_before = level, self.level or level
        self._textures[level].write(np.ascontiguousarray(array))
        self.bytes_written += array.nbytes
