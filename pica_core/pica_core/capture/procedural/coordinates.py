"""What each vertex is made of and which named parts it belongs to: fixed once per identity.

`SurfaceCoordinates` is what the appearance shader paints by; regions are what trainers weigh and
tests ask for.
"""

from dataclasses import dataclass

import numpy as np

from pica_core.capture.dataset.multiface import MATERIALS
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
from pica_core.capture.procedural.surface import EYE_RADIUS
from pica_core.types import BoolArray, Float64Array, FloatArray

_MATERIAL_OF = {
    "eye_left": "eye",
    "eye_right": "eye",
    "teeth_upper": "teeth",
    "teeth_lower": "teeth",
    "ear_left": "skin",
    "ear_right": "skin",
}
FAR_ROWS = 30.0
"""Rows to the nearest lid margin, at most; also where there is none."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SurfaceCoordinates:
    """What the appearance needs to know about each vertex.

    Attributes:
        material: Index into `MATERIALS`. float32 ``[V]``.
        rest_m: Position at rest, head frame, metres. float32 ``[V, 3]``.
        local: Four numbers per vertex whose meaning depends on the material. float32 ``[V, 4]``.
            Skin: vermilion depth (0 at the border, 1 at the contact line), rows to the nearest lid
            margin, hair coverage, and 1 on ears, -1 above the eye slits (fading beside them). Eye:
            direction from the eyeball's centre, side. Teeth: place along the arch, place from gum
            to edge, 1 for the upper ones. Everything else: chart row and column from 0 to 1.
    """

    material: FloatArray
    rest_m: FloatArray
    local: FloatArray


def _skin_coordinates(chart: Chart, skin: Skin, identity: Identity) -> Float64Array:
    row = np.repeat(chart.rows.astype(np.float64), len(chart.columns))
    across, y, z = skin.points.reshape(-1, 3).T
    x = np.abs(across)
    upper = (row - UPPER_BORDER_ROW) / (UPPER_CONTACT_ROW - UPPER_BORDER_ROW)
    lower = (LOWER_BORDER_ROW - row) / (LOWER_BORDER_ROW - LOWER_CONTACT_ROW)
    depth = np.where(row <= MOUTH_ROW, upper, lower)
    # Past the corner the lips end: their depth falls below the border there.
    depth = depth - 2.2 * smoothstep(skin.mouth_half - 0.6, skin.mouth_half + 3.4, x)
    near_mouth = (x < skin.mouth_half + 12) & (z > 50)
    inner, outer = skin.eye_corners
    beyond = np.maximum(np.maximum(inner - x, x - outer), 0.0)
    steps = np.abs(np.where(row <= EYE_ROW, row - EYE_ROW, row - EYE_ROW - 1))
    lid = np.minimum(steps + 1.3 * beyond, FAR_ROWS)
    above_hairline = y - hairline(identity, np.arctan2(across, z))
    columns = [
        np.where(near_mouth, np.clip(depth, -3.0, 2.5), -3.0),
        np.where(z > 40, lid, FAR_ROWS),
        np.clip(above_hairline / 20.0, -1.0, 1.0),
        np.where(row <= EYE_ROW, -1.0, 0.0) * smoothstep(5.0, 0.5, beyond),
    ]
    return np.stack(columns, -1)


def surface_coordinates(
    identity: Identity,
    charts: dict[str, Chart],
    skin: Skin,
    neutral_m: FloatArray,
    eye_centre_mm: Float64Array,
) -> SurfaceCoordinates:
    """Coordinates of every vertex of a head from its rest pose and its left eye's centre."""
    material = np.zeros(len(neutral_m), np.float32)
    local = np.zeros((len(neutral_m), 4), np.float32)
    for name, chart in charts.items():
        rows, columns = (value.ravel() for value in chart.unit)
        span = chart.span
        material[span] = MATERIALS.index(_MATERIAL_OF.get(name, name))
        if name == "skin":
            local[span] = _skin_coordinates(chart, skin, identity)
        elif name.startswith("eye"):
            side = 1.0 if name == "eye_left" else -1.0
            centre = eye_centre_mm * [side, 1.0, 1.0]
            local[span, :3] = (1000.0 * neutral_m[span] - centre) / EYE_RADIUS
            local[span, 3] = side
        elif name.startswith("teeth"):
            local[span, 0], local[span, 1] = 2 * columns - 1, rows
            local[span, 2] = 1.0 if name == "teeth_upper" else -1.0
        elif name.startswith("ear"):
            local[span] = [-3.0, FAR_ROWS, 0.0, 1.0]
            local[span, 2] = columns
        else:
            local[span, 0], local[span, 1] = rows, columns
    return SurfaceCoordinates(material=material, rest_m=neutral_m, local=local)


def name_regions(
    charts: dict[str, Chart], coordinates: SurfaceCoordinates, lids: BoolArray
) -> dict[str, BoolArray]:
    """Named vertex sets of a head, bool ``[V]`` each; `lids` are those that lids are made of."""

    def of(*names: str) -> BoolArray:
        mask = np.zeros(len(lids), np.bool_)
        for name in names:
            mask[charts[name].span] = True
        return mask

    skin = of("skin")
    x, y, z = coordinates.rest_m.T
    chart = charts["skin"]
    row = np.zeros(len(lids))
    row[chart.span] = np.repeat(chart.rows, len(chart.columns))
    lips = skin & (coordinates.local[:, 0] > -0.15)
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
