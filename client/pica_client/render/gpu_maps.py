"""The decoded maps of one slot on the GPU, by kind and level: uploaded into textures of their own,
or drawn by a decoder in shaders into textures that many heads share.

A kind remembers which level came last and which one before it, so that a change of level can fade
in: `Placement.blend` mixes the two.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import moderngl
import numpy as np

from pica_client.render.gpu_program import clamp
from pica_core.errors import ShapeError
from pica_core.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class MapView:
    """A map: so many rows of a texture, in all its columns."""

    texture: moderngl.Texture
    first_row: int
    num_rows: int

    @property
    def key(self) -> tuple[int, int]:
        """The same for the same part of the same texture."""
        return self.texture.glo, self.first_row

    def read(self) -> FloatArray:
        """What is there, ``[rows, columns, channels]``; for tests."""
        size = self.texture.height, self.texture.width, self.texture.components
        values = np.frombuffer(self.texture.read(), np.float32).reshape(size)
        return values[self.first_row : self.first_row + self.num_rows]


def whole_map(texture: moderngl.Texture) -> MapView:
    """A texture as a map."""
    return MapView(texture, 0, texture.height)


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
        self._views: dict[int, MapView] = {}
        self.level = self.level_before = 0
        """Level of the map that came last, 0 if none came; and of the last map of another level
        before, or the same where there is none."""
        self.bytes_written = 0
        """What `write` has uploaded so far."""

    @property
    def newest(self) -> MapView:
        """What came last. Not to be asked before the first map."""
        return self._views[self.level]

    @property
    def before(self) -> MapView:
        """The last map of the level before; the newest where there is none."""
        return self._views[self.level_before]

    def check(self, array: FloatArray) -> None:
        """Raise a ShapeError for what is not float32, or of no level's shape."""
        shapes = [(rows, level, self._components) for level, rows in self._rows.items()]
        if array.shape not in shapes or array.dtype != np.float32:
            known = ", ".join(map(str, shapes))
            raise ShapeError(f"map is {array.dtype} {array.shape}; float32 {known} is needed")

    def write(self, array: FloatArray) -> None:
        """Upload a map that `check` has passed."""
        level = array.shape[1]
        view = self._views.get(level)
        if view is None:
            size = (level, self._rows[level])
            texture = self._context.texture(size, self._components, dtype="f4")
            view = whole_map(clamp(texture, self._filtering))
        view.texture.write(np.ascontiguousarray(array))
        self.bytes_written += array.nbytes
        self.show(level, view)

    def show(self, level: int, view: MapView) -> None:
        """Take what is there as the newest map."""
        self._views[level] = view
        if level != self.level:
            self.level, self.level_before = level, self.level or level
