"""Where every part of the built-in head lives in the UV square.

The position map has 256 x 256 texels; mesh vertices sit exactly on texel centres, so reading a
position map at the vertices involves no interpolation at all. A chart is a rectangle of texels;
its vertices are the crossings of chosen rows with chosen columns (a tensor grid). Densities change
by skipping rows or columns as a whole, so there are no T-junctions and no cracks. Slits (mouth,
eyes) are missing quads between two neighbouring rows.
"""

from dataclasses import dataclass

import numpy as np

from pica_core.capture.dataset.files import MAP_SIZE
from pica_core.types import BoolArray, Float64Array, FloatArray, IntArray

EYE_ROW = 70
"""Skin row of the upper lid's inner edge; the lower lid's is the next row."""
MOUTH_ROW = 124
"""Skin row of the upper lip's innermost edge; the lower lip's is the next row."""
SKIN_ROWS = 164
"""Texel rows of the skin chart, crown to neck."""
MIDLINE_COLUMN = 127.5
"""The face's plane of symmetry lies between columns 127 and 128."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Chart:
    """A rectangle of the UV square with its vertex grid.

    Attributes:
        name: Chart name, e.g. ``skin`` or ``eye_left``.
        rows: Texel rows of the grid lines, ascending. int32 ``[R]``.
        columns: Texel columns of the grid lines, ascending. int32 ``[C]``.
        first: Index of the chart's first vertex.
        flip: True when rows x columns runs clockwise seen from outside.
    """

    name: str
    rows: IntArray
    columns: IntArray
    first: int
    flip: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """Grid lines along rows and columns."""
        return len(self.rows), len(self.columns)

    @property
    def count(self) -> int:
        """Number of vertices."""
        return len(self.rows) * len(self.columns)

    @property
    def span(self) -> slice:
        """The chart's vertices in the head's vertex arrays."""
        return slice(self.first, self.first + self.count)

    @property
    def unit(self) -> tuple[Float64Array, Float64Array]:
        """Row and column of every vertex, 0 to 1 over the chart. Two float64 ``[R, C]``."""
        r = (self.rows - self.rows[0]) / (self.rows[-1] - self.rows[0])
        c = (self.columns - self.columns[0]) / (self.columns[-1] - self.columns[0])
        rows, columns = np.meshgrid(r, c, indexing="ij")
        return rows, columns

    @property
    def vertex_uv(self) -> FloatArray:
        """Texture coordinates of the vertices. float32 ``[R * C, 2]``."""
        rows, columns = np.meshgrid(self.rows, self.columns, indexing="ij")
        return ((np.stack([columns, rows], -1).reshape(-1, 2) + 0.5) / MAP_SIZE).astype(np.float32)

    def faces(self, hole: BoolArray | None = None) -> IntArray:
        """Triangles of the grid, counter-clockwise seen from outside.

        Args:
            hole: True for quads to leave out. bool ``[R - 1, C - 1]``.
        """
        num_rows, num_columns = self.shape
        index = self.first + np.arange(self.count).reshape(num_rows, num_columns)
        a, b = index[:-1, :-1], index[:-1, 1:]
        c, d = index[1:, :-1], index[1:, 1:]
        if self.flip:
            a, b, c, d = b, a, d, c
        quads = np.stack([a, c, b, b, c, d], -1)
        if hole is not None:
            quads = quads[~hole]
        return quads.reshape(-1, 3).astype(np.int32)


def _lines(*spans: tuple[int, int, int]) -> IntArray:
    """Grid lines from (start, stop, stride) spans; the last stop is included."""
    lines = [np.arange(start, stop, stride) for start, stop, stride in spans]
    return np.unique(np.concatenate([*lines, [spans[-1][1]]])).astype(np.int32)


def _skin_columns() -> IntArray:
    """Columns of the skin, symmetric about the midline: fine on the face, coarse at the back."""
    right_half = np.concatenate([np.arange(128, 192, 2), np.arange(192, 256, 3), [255]])
    return np.unique(np.concatenate([255 - right_half, right_half])).astype(np.int32)


def _even(start: int, size: int, stride: int) -> IntArray:
    """Grid lines over `size` texels from `start`, both ends included."""
    return _lines((start, start + size - 1, stride))


def build_charts() -> dict[str, Chart]:
    """All charts of the built-in topology, by name, with consecutive vertex ranges."""
    skin_rows = _lines((0, 40, 4), (40, 52, 2), (52, SKIN_ROWS - 1, 1))
    plan: list[tuple[str, IntArray, IntArray, bool]] = [
        ("skin", skin_rows, _skin_columns(), False),
        ("eye_left", _even(168, 35, 2), _even(41, 35, 2), False),
        ("eye_right", _even(168, 35, 2), _even(2, 35, 2), False),
        ("teeth_upper", _even(168, 17, 1), _even(81, 65, 1), False),
        ("teeth_lower", _even(189, 17, 1), _even(81, 65, 1), True),
        ("ear_left", _even(207, 47, 1), _even(26, 21, 1), False),
        ("ear_right", _even(207, 47, 1), _even(2, 21, 1), True),
        ("tongue", _even(209, 27, 2), _even(52, 27, 2), False),
        ("mouth_bag", _even(209, 27, 2), _even(83, 37, 2), False),
        ("collar", _even(239, 15, 1), _even(51, 95, 1), False),
        ("hair", _even(168, 87, 2), _even(150, 103, 2), False),
    ]
    charts: dict[str, Chart] = {}
    first = 0
    for name, rows, columns, flip in plan:
        chart = Chart(name=name, rows=rows, columns=columns, first=first, flip=flip)
        charts[name] = chart
        first += chart.count
    return charts
