"""What a built-in head is as a rig: its features, its hair and its colours, known as it is made.

A rig from a file is searched for mouth, eyes and regions (`rig.features`); here the rows of the
charts say where they are.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.person.dress import grow_beard
from pica_core.capture.procedural.hair import hairline
from pica_core.capture.procedural.identity import Identity
from pica_core.capture.procedural.layout import EYE_ROW, MOUTH_ROW, Chart
from pica_core.capture.procedural.skin import (
    LOWER_BORDER_ROW,
    LOWER_CONTACT_ROW,
    UPPER_BORDER_ROW,
    UPPER_CONTACT_ROW,
    Skin,
    smoothstep,
)
from pica_core.capture.procedural.surface import EYE_Y
from pica_core.capture.rig.features import FAR_M, Features, Mouth
from pica_core.capture.rig.skin import Growth
from pica_core.capture.triangles import nearest
from pica_core.types import BoolArray, Float64Array, FloatArray, IntArray

_MATERIAL_OF = {
    "eye_left": "eye",
    "eye_right": "eye",
    "teeth_upper": "teeth",
    "teeth_lower": "teeth",
    "ear_left": "skin",
    "ear_right": "skin",
}
AROUND_M = {"hair": (0.50, 0.0), "collar": (0.90, 0.06)}
"""Size of a chart in metres, across and along, for weaves and strands."""
FRINGE_MM = 25.0
"""A fringe hangs from so much higher up than it ends."""
ROOTS = (0.0, 0.6, -0.8)
"""Direction of the roots that are painted under the hair's edge."""


def chart_features(
    identity: Identity,
    charts: dict[str, Chart],
    skin: Skin,
    rest_m: FloatArray,
    faces: IntArray,
    lids: BoolArray,
) -> Features:
    """Features of a head at rest; `lids` are the vertices that lids are made of. ``[V]``."""
    chart = charts["skin"]
    span, count = chart.span, len(rest_m)
    row = np.full(count, -1.0)
    row[span] = np.repeat(chart.rows, len(chart.columns))
    grid = rest_m[span].reshape(*chart.shape, 3).astype(np.float64)
    lips, gap = np.full(count, -3.0), np.full(count, FAR_M)
    lips[span] = _depth_in_lips(row[span], 1000 * rest_m[span], skin)
    at = int(np.flatnonzero(chart.rows == EYE_ROW)[0])
    inner, outer = (corner / 1000 for corner in skin.eye_corners)
    for margin in (grid[at], grid[at + 1]):
        x = np.abs(margin[:, 0])
        margin = margin[(x > inner - 0.001) & (x < outer + 0.001) & (margin[:, 2] > 0.05)]
        between = np.linalg.norm(np.diff(margin, axis=0), axis=1) < 0.005  # not across the nose
        dense = np.concatenate([margin, 0.5 * (margin[1:] + margin[:-1])[between]])
        near = np.flatnonzero((np.abs(rest_m[:, 1] - EYE_Y / 1000) < 0.03) & (rest_m[:, 2] > 0.04))
        _, distance = nearest(rest_m[near, :2].astype(np.float64), dense[:, :2])
        gap[near] = np.minimum(gap[near], distance)
    contact = grid[int(np.flatnonzero(chart.rows == UPPER_CONTACT_ROW)[0])]
    contact = contact[(np.abs(contact[:, 0]) < skin.mouth_half / 1000) & (contact[:, 2] > 0.04)]
    x, y, z = contact[np.argsort(contact[:, 0])].T
    ridge = grid[(np.abs(grid[..., 0]) < 0.012) & (grid[..., 1] > y.mean() + 0.01)]
    ridge = ridge[ridge[:, 1] < EYE_Y / 1000]
    part = np.zeros(count, np.int32)
    for name, each in charts.items():
        part[each.span] = MATERIALS.index(_MATERIAL_OF.get(name, name))
    return Features(
        mouth=Mouth(half_m=skin.mouth_half / 1000, x=x, y=y, z=z, centre_x=0.0),
        lips=lips,
        eye_gap_m=gap,
        above_eye=(row >= 0) & (row <= EYE_ROW),
        brow_y=(EYE_Y + identity.face.brow_height) / 1000,
        nose_tip=ridge[ridge[:, 2].argmax()],
        part=part[faces[:, 0]],
        regions=_name_regions(charts, rest_m, row, lips, lids),
    )


def _depth_in_lips(row: Float64Array, points_mm: FloatArray, skin: Skin) -> Float64Array:
    """Depth in the lips, as `Mouth.depth_in_lips`, of points of the skin chart."""
    x = np.abs(points_mm[:, 0])
    upper = (row - UPPER_BORDER_ROW) / (UPPER_CONTACT_ROW - UPPER_BORDER_ROW)
    lower = (LOWER_BORDER_ROW - row) / (LOWER_BORDER_ROW - LOWER_CONTACT_ROW)
    depth = np.where(row <= MOUTH_ROW, upper, lower)
    # Past the corner the lips end: their depth falls below the border there.
    depth = depth - 2.2 * smoothstep(skin.mouth_half - 0.6, skin.mouth_half + 3.4, x)
    near_mouth = (x < skin.mouth_half + 12) & (points_mm[:, 2] > 50)
    return np.where(near_mouth, np.clip(depth, -3.0, 2.5), -3.0)


def _name_regions(
    charts: dict[str, Chart],
    rest_m: FloatArray,
    row: Float64Array,
    lip_depth: Float64Array,
    lids: BoolArray,
) -> dict[str, BoolArray]:
    """Named vertex sets of a head, bool ``[V]`` each."""

    def of(*names: str) -> BoolArray:
        mask = np.zeros(len(lids), np.bool_)
        for name in names:
            mask[charts[name].span] = True
        return mask

    skin = of("skin")
    x, y, z = rest_m.T
    lips = skin & (lip_depth > -0.15)
    interior = of("teeth_upper", "teeth_lower", "tongue", "mouth_bag")
    around = skin & (np.abs(x) < 0.042) & (np.abs(y - y[lips].mean()) < 0.024) & (z > 0.05)
    neck = skin & (row > 154)
    scalp = skin & ((row < 36) | (z < 0.0)) & ~neck
    return {
        "face": skin & ~neck & ~scalp,
        "lips": lips,
        "lids": lids,
        "mouth_interior": interior,
        "mouth": interior | around | lips,
        "eyeballs": of("eye_left", "eye_right"),
        "eyes": of("eye_left", "eye_right") | lids,
        "teeth": of("teeth_upper", "teeth_lower"),
        "tongue": of("tongue"),
        "ears": of("ear_left", "ear_right"),
        "neck": neck,
        "scalp": scalp,
        "hair": of("hair"),
        "collar": of("collar"),
        "left": x > 0,
    }


def source_uv(identity: Identity, charts: dict[str, Chart], vertex_uv: FloatArray) -> Float64Array:
    """Coordinates that weaves and strands follow, in metres on hair and collar. ``[V, 2]``."""
    uv = vertex_uv.astype(np.float64)
    for name, size in AROUND_M.items():
        rows, columns = charts[name].unit
        if name == "hair":  # strands turn on their way down, and wave
            wave = 0.012 * identity.hair.curl * np.sin(16.0 * rows)
            columns = columns - identity.hair.sweep / (2 * np.pi) * rows + wave
        uv[charts[name].span] = np.stack([columns.ravel(), rows.ravel()], 1) * size
    return uv


def grown_hair(
    identity: Identity, charts: dict[str, Chart], rest_m: FloatArray, features: Features
) -> Growth:
    """Strands of the hair shell, roots painted on the scalp, and a beard."""
    chart, skin = charts["hair"], charts["skin"].span
    hairs, strand = np.zeros((len(rest_m), 5), np.float32), np.zeros((len(rest_m), 4), np.float32)
    x, y, z = 1000 * rest_m[skin].T.astype(np.float64)
    hairs[:, 0] = -1.0
    line = hairline(identity, np.arctan2(x, z)) + FRINGE_MM * (identity.hair.fringe > 0)
    hairs[skin, 0] = np.clip((y - line) / 14.0, -1.0, 1.0)
    hairs[skin, 1:4] = ROOTS
    if identity.skin.beard:
        inside = features.lips > 1.2
        # Rows lie farther apart outside the lips than in them.
        below = replace(features, lips=np.where(features.lips < 0, 5.0, 1.0) * features.lips)
        on_skin = np.zeros(len(rest_m), np.bool_)
        on_skin[skin] = True
        beard, _ = grow_beard(rest_m.astype(np.float64), on_skin, inside, below, "short")
        hairs[:, 4] = identity.skin.beard * beard
        hairs[beard > 0.02, 1:4] = [0.0, -0.9, 0.45]
    grid = rest_m[chart.span].reshape(*chart.shape, 3)
    way = np.asarray(np.gradient(grid, axis=0))
    hairs[chart.span, 1:4] = way.reshape(-1, 3)
    rows, columns = chart.unit
    length = np.linalg.norm(np.diff(grid, axis=0), axis=2).sum(0).mean()
    strand[chart.span] = np.stack(
        [
            rows.ravel(),
            2 * columns.ravel() - 1,
            np.zeros(chart.count),
            np.full(chart.count, length),
        ],
        1,
    )
    for name in ("teeth_upper", "teeth_lower"):
        across = np.abs(2 * charts[name].unit[1].ravel() - 1)
        strand[charts[name].span, 0] = smoothstep(0.55, 0.9, across)
    return Growth(hairs=hairs, strand=strand)


def look(identity: Identity) -> dict[str, Any]:
    """Colours and marks of an identity, as `appearance.frag` names them."""
    skin, hair = identity.skin, identity.hair
    return {
        "seed": float(identity.seed), "skin_rgb": skin.rgb, "lip_rgb": skin.lip_rgb,
        "redness": skin.redness, "freckles": skin.freckles, "stubble": skin.stubble,
        "makeup": skin.makeup, "age": skin.age, "brow_rgb": skin.brow_rgb,
        "brows": skin.brow_thickness, "iris_rgb": skin.iris_rgb, "cloth_rgb": skin.cloth_rgb,
        "hair_rgb": hair.rgb, "grey": hair.grey,
    }  # fmt: skip
