"""How far the mesh of an avatar reaches: room beside it and where it fades follow from it."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from pica_core.avatar.file import Avatar
from pica_core.types import Array, FloatArray

WHOLE_M = (-1e6, -1e6 + 1.0)
"""Heights of what does not fade."""
BORDER_M = 0.045
"""So far above its lower border a bust is gone: that is ragged, and higher at the arms."""
FADE_M = 0.1
"""Over which height it fades (chosen: shoulders are seen, and no edge)."""
LOWEST_M = -0.31
"""Longer busts end here, too: in a call all are of one size."""
CHIN_M = -0.12
"""Nothing above fades, however short a bust is."""

NUM_OUTLINE = 96
"""Points of an outline: neighbours of them see directions that are 18 degrees apart."""
OUTLINE_MARGIN_M = 0.004
"""An outline is so much wider than what it holds: shoulders bulge so far between its directions."""
NUM_LOOKED = 600
"""Directions in which an outline is checked: a spike of 0.3 m is missed by a millimetre."""
LOOKED_AT_ONCE = 2000
"""Vertices: what comes of more of them leaves the processor's cache (a fifth of the time)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Bust:
    """The extent of the mean face's mesh, head frame, metres."""

    width_m: float
    """Twice the way from the middle to the farther side: the width of the shoulders, as a rule."""
    lower_m: float
    """The height at which the mesh ends below."""


def bust_of(avatar: Avatar) -> Bust:
    """Measure an avatar, a few milliseconds; what no triangle uses or is no number is left out."""
    used = avatar.mean_vertices_m[np.unique(avatar.tensors["mesh.faces"])]
    used = used[np.isfinite(used).all(axis=1)]
    if not len(used):
        return Bust(width_m=0.0, lower_m=0.0)
    return Bust(width_m=2 * float(np.abs(used[:, 0]).max()), lower_m=float(used[:, 1].min()))


def seen_faces(faces: Array, vertices_m: Array, gone_m: float) -> Array:
    """The triangles ``[F, 3]`` that reach up to where something is left of a bust at rest: others
    would only hide what is behind them. All, where none does: such a mesh is no bust."""
    is_seen: Array = vertices_m[faces, 1].max(axis=1) > gone_m
    return faces[is_seen] if is_seen.any() else faces


def fade_heights_m(lower_m: float) -> tuple[float, float]:
    """Heights in the head frame at which nothing is left of a bust whose mesh ends at `lower_m`,
    and from which all is there."""
    gone = max(lower_m + BORDER_M, LOWEST_M)
    return gone, max(min(gone + FADE_M, CHIN_M), gone + 0.005)


def outline_of(vertices_m: FloatArray, slack_m: float = 0.0) -> FloatArray:
    """Points that hold vertices ``[V, 3]`` between them wherever these go within a distance: the
    outermost in each of many directions, moved outwards. float32 ``[NUM_OUTLINE, 3]``."""
    sound_m = vertices_m[np.isfinite(vertices_m).all(axis=1)].astype(np.float32)
    if not len(sound_m):
        sound_m = np.zeros((1, 3), np.float32)
    directions = even_directions(NUM_OUTLINE)
    outermost_m = sound_m[np.matmul(directions, sound_m.T).argmax(axis=1)]
    outline_m: FloatArray = outermost_m + (slack_m + OUTLINE_MARGIN_M) * directions
    # A spike between the directions is found by looking in many more.
    looked = even_directions(NUM_LOOKED)
    parts = np.array_split(sound_m, -(-len(sound_m) // LOOKED_AT_ONCE))
    reach_m = np.max([np.matmul(looked, part.T).max(axis=1) for part in parts], axis=0)
    missing_m = reach_m + slack_m - np.matmul(looked, outline_m.T).max(axis=1)
    return outline_m + max(float(missing_m.max()), 0.0) * directions


@cache
def even_directions(count: int) -> FloatArray:
    """Unit vectors that are spread evenly, ``[count, 3]``."""
    index = np.arange(count)
    height, turn = 1 - (2 * index + 1) / count, index * np.pi * (3 - 5**0.5)
    level = np.sqrt(1 - height**2)
    spread = np.stack([level * np.cos(turn), height, level * np.sin(turn)], axis=1)
    return spread.astype(np.float32)


def box_corners(low_m: npt.ArrayLike, high_m: npt.ArrayLike) -> FloatArray:
    """The corners of a box between two opposite ones. ``[8, 3]``."""
    picks = (np.arange(8)[:, None] >> np.arange(3)) & 1
    return np.where(picks == 1, high_m, low_m).astype(np.float32)
