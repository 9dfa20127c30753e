"""Where each ARKit shape may move a head: zones of the face, and the share of motion in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES, NUM_ARKIT
from pica_core.capture.procedural.heads import ProceduralHead
from pica_core.types import Float64Array

ZONES = ("brow", "eye", "nose", "cheek", "mouth", "jaw", "rest", "eyeball", "inside", "tongue")
"""Zones: parts of the skin, then what is not skin. `inside`: lower teeth and mouth cavity; `jaw`
reaches to the throat; `rest`: everything that no expression should move."""

EYE_Y = 22.0
"""Height of the eyes of every head, mm."""
LEAST_SHARE = 0.9
"""Share of a shape's squared motion that must lie in its zones, and on its side."""
MOST_ELSEWHERE_MM = 4.0
"""How far a shape may move anything outside its zones: skin is soft, borders of zones are not."""

_MOUTH = ("mouth", "cheek", "jaw")
_ZONES_OF: dict[str, tuple[str, ...]] = {
    "eyeBlink": ("eye",),
    "eyeLookDown": ("eyeball", "eye"),
    "eyeLookIn": ("eyeball",),
    "eyeLookOut": ("eyeball",),
    "eyeLookUp": ("eyeball", "eye"),
    "eyeSquint": ("eye", "cheek", "brow"),
    "eyeWide": ("eye", "brow"),
    "jawForward": ("jaw", "mouth", "cheek", "inside", "tongue"),
    "jawLeft": ("jaw", "mouth", "cheek", "inside", "tongue"),
    "jawRight": ("jaw", "mouth", "cheek", "inside", "tongue"),
    "jawOpen": ("jaw", "mouth", "cheek", "inside", "tongue"),
    "mouthClose": ("mouth", "jaw", "cheek"),
    "mouthFunnel": _MOUTH,
    "mouthPucker": _MOUTH,
    "mouthLeft": _MOUTH,
    "mouthRight": _MOUTH,
    "mouthSmile": ("mouth", "cheek", "jaw", "nose"),
    "mouthFrown": _MOUTH,
    "mouthDimple": _MOUTH,
    "mouthStretch": _MOUTH,
    "mouthRollLower": ("mouth", "jaw"),
    "mouthRollUpper": ("mouth",),
    "mouthShrugLower": ("mouth", "jaw"),
    "mouthShrugUpper": ("mouth",),
    "mouthPress": ("mouth",),
    "mouthLowerDown": ("mouth", "jaw"),
    "mouthUpperUp": ("mouth", "nose", "cheek"),
    "browDown": ("brow", "eye", "nose"),
    "browInnerUp": ("brow", "nose"),
    "browOuterUp": ("brow",),
    "cheekPuff": ("cheek", "mouth", "jaw"),
    "cheekSquint": ("cheek", "eye"),
    "noseSneer": ("nose", "mouth", "cheek", "eye"),
    "tongueOut": ("tongue", "mouth", "jaw", "inside", "cheek"),
}


def zones_of(shape: str) -> tuple[str, ...]:
    """Zones that an ARKit shape's name says it moves; the one that it must move comes first."""
    bare = shape.removesuffix("Left").removesuffix("Right")
    return _ZONES_OF[shape] if shape in _ZONES_OF else _ZONES_OF[bare]


def side_of(shape: str) -> float:
    """+1 for shapes of the subject's left half, -1 for the right half, 0 for both."""
    if shape in ("jawLeft", "jawRight", "mouthLeft", "mouthRight"):
        return 0.0
    return 1.0 if shape.endswith("Left") else -1.0 if shape.endswith("Right") else 0.0


def vertex_zones(head: ProceduralHead) -> npt.NDArray[np.int64]:
    """Index into `ZONES` of every vertex. ``[V]``."""
    x, y, z = (head.rest_m.astype(np.float64) * 1000.0).T
    x = np.abs(x)
    marks = head.landmarks
    nose_y, mouth_y, half = marks["nose_y"], marks["mouth_y"], marks["mouth_half"]
    brow_from = 0.5 * (EYE_Y + marks["brow_y"])
    zone = np.full(len(head.vertex_uv), ZONES.index("rest"))
    skin = np.zeros(len(head.vertex_uv), np.bool_)
    skin[head.charts["skin"]] = True
    face = skin & (z > -2.0)

    def claim(name: str, where: npt.NDArray[np.bool_]) -> None:
        zone[face & where] = ZONES.index(name)

    claim("jaw", y < mouth_y + 12.0)
    claim("cheek", (y >= mouth_y - 6.0) & (y < EYE_Y - 6.0) & (z > 20.0))
    claim("mouth", (x < half + 13.0) & (y >= mouth_y - 20.0) & (y < nose_y - 2.0) & (z > 60.0))
    claim("nose", (x < 21.0) & (y >= nose_y - 2.0) & (y < brow_from) & (z > 60.0))
    near_eye = (np.abs(x - marks["eye_x"]) < 23.0) & (y >= EYE_Y - 15.0) & (y < brow_from)
    claim("eye", near_eye & (z > 55.0) & (x > 12.0))
    claim("brow", (y >= brow_from) & (z > 20.0))
    for name, charts in (
        ("eyeball", ("eye_left", "eye_right")),
        ("inside", ("teeth_lower", "mouth_bag")),
        ("tongue", ("tongue",)),
    ):
        for chart in charts:
            zone[head.charts[chart]] = ZONES.index(name)
    return zone


@dataclass(frozen=True, kw_only=True, slots=True)
class Motion:
    """What one shape at 1 does to one head."""

    shape: str
    """ARKit name."""
    peak_mm: float
    """Largest motion in the zone that the shape must move."""
    share: float
    """Share of all squared motion that lies in the shape's zones."""
    side_share: float
    """Share on the shape's side; 1 for shapes of both sides."""
    elsewhere_mm: float
    """Largest motion outside the shape's zones."""
    moved: dict[str, float]
    """Share of squared motion by zone, zones below one percent left out."""


def all_motions(head: ProceduralHead) -> list[Motion]:
    """Measure every ARKit shape of one head at 1.

    `mouthClose` is a corrective, so it is measured over an open jaw.
    """
    zone = vertex_zones(head)
    before = np.zeros((NUM_ARKIT, NUM_ARKIT))
    before[ARKIT_INDEX["mouthClose"], ARKIT_INDEX["jawOpen"]] = 1.0
    after = before + np.eye(NUM_ARKIT)
    rest, jaw = head.vertices_batch(before[[0, ARKIT_INDEX["mouthClose"]]])
    result = []
    for shape, posed in zip(ARKIT_NAMES, head.vertices_batch(after), strict=True):
        start = jaw if shape == "mouthClose" else rest
        moved = (posed.astype(np.float64) - start) * 1000.0
        result.append(_measure(head, shape, zone, np.linalg.norm(moved, axis=1)))
    return result


def _measure(
    head: ProceduralHead, shape: str, zone: npt.NDArray[np.int64], distance: Float64Array
) -> Motion:
    square = distance**2
    total = max(float(square.sum()), 1e-12)
    wanted = [ZONES.index(name) for name in zones_of(shape)]
    inside = np.isin(zone, wanted)
    side = side_of(shape)
    on_side = np.ones_like(inside) if side == 0 else side * head.rest_m[:, 0] > 0
    by_zone = {name: float(square[zone == i].sum()) / total for i, name in enumerate(ZONES)}
    return Motion(
        shape=shape,
        peak_mm=float(distance[zone == wanted[0]].max()),
        share=float(square[inside].sum()) / total,
        side_share=float(square[on_side].sum()) / total,
        elsewhere_mm=float(distance[~inside].max()),
        moved={name: share for name, share in by_zone.items() if share >= 0.01},
    )
