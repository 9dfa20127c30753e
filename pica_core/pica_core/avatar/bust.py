"""How far the mesh of an avatar reaches: room beside it and where it fades follow from it."""

from dataclasses import dataclass

import numpy as np

from pica_core.avatar.file import Avatar
from pica_core.types import Array

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
