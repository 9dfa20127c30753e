"""Clothes of a person: one surface from the neckline over the shoulders, by the neck it is laid on.

Skin below the neckline goes, so that nothing can cut through. Metres, head frame; turn 0 is the
back, a half turn the front.
"""

from dataclasses import dataclass

import numpy as np

from pica_core.capture.person.hair import Surface, join_rings, lumps, smooth
from pica_core.types import BoolArray, Float64Array

COLUMNS, ROWS = 72, 22
AXIS_Z = -0.028
"""Depth of the neck's axis."""
HIDDEN_M = 0.014
"""How far below the neckline skin ends."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Cut:
    """A neckline; lengths are millimetres."""

    front: float
    """Height of the neckline in front, in the head frame."""
    back: float
    vee: float = 0.0
    """How much deeper a point in front goes."""
    band: float = 2.0
    """How far the fabric stands up above the neckline."""
    roll: float = 1.5
    """Thickness of its edge."""
    turned: float = 0.0
    """Length of a collar that is turned down over it."""
    folds: float = 1.0


CUTS: dict[str, Cut] = {
    "tee": Cut(front=-142, back=-98, band=2, roll=1.8),
    "vneck": Cut(front=-140, back=-98, vee=28, band=1.5, roll=1.5),
    "shirt": Cut(front=-140, back=-102, vee=12, band=16, roll=2.0, turned=30, folds=0.8),
    "turtleneck": Cut(front=-122, back=-92, band=12, roll=3.5, turned=14, folds=1.1),
    "hoodie": Cut(front=-142, back=-102, band=10, roll=7.0, turned=24, folds=1.8),
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Garment:
    """A garment.

    Attributes:
        rim_y: Height of the neckline by turn. ``[COLUMNS]``.
        rim: Its distance from the neck's axis. ``[COLUMNS]``.
    """

    surface: Surface
    rim_y: Float64Array
    rim: Float64Array

    def hides(self, points: Float64Array) -> BoolArray:
        """Which points of a skin lie under it. ``[P]``."""
        turn = np.arctan2(points[:, 0], -(points[:, 2] - AXIS_Z)) % (2 * np.pi)
        place = turn / (2 * np.pi) * COLUMNS
        low = place.astype(np.int64) % COLUMNS
        t = place - np.floor(place)
        rim_y, rim = (
            each[low] * (1 - t) + each[(low + 1) % COLUMNS] * t for each in (self.rim_y, self.rim)
        )
        reach = np.hypot(points[:, 0], points[:, 2] - AXIS_Z)
        beside = (reach > rim + 0.003) & (points[:, 1] < rim_y - 0.002)
        return (points[:, 1] < rim_y - HIDDEN_M) | beside


def dress_surface(skin: Float64Array, cut: Cut, seed: int) -> Garment:
    """A garment on a neck, for skin ``[P, 3]``."""
    turn = 2 * np.pi * np.arange(COLUMNS) / COLUMNS
    front, side = -np.cos(turn), np.sin(turn)
    share = smooth(front + 0.25)
    rim_y = (cut.back + (cut.front - cut.back) * share) / 1000
    rim_y = rim_y - cut.vee / 1000 * np.clip(1 - np.abs(side) / 0.55, 0, 1) * (front > 0)
    rim = _reach(skin, turn, rim_y)
    rows: list[Float64Array] = []

    def ring(out: Float64Array | float, y: Float64Array | float) -> None:
        reach = rim + out
        rows.append(np.stack([side * reach, rim_y + y, AXIS_Z + front * reach], 1))

    band, roll = cut.band / 1000, cut.roll / 1000
    ring(-0.006, -0.008)
    ring(0.0008, band - roll)
    ring(0.4 * roll + 0.001, band)
    ring(roll + 0.0015, band - 0.5 * roll)
    if cut.turned:
        drop = cut.turned / 1000 * (0.75 + 0.25 * share)
        for k in (0.35, 0.7, 1.0):
            ring(roll + 0.002 + 0.35 * drop * k, band - 0.5 * roll - drop * k * 0.9)
        ring(roll + 0.0005 + 0.24 * drop, band - 0.5 * roll - drop * 0.93)
        ring(0.0035 + 0.10 * drop, np.minimum(band - drop * 0.6, -0.001))
    else:
        ring(roll + 0.001, -0.004)
    at_reach, at_y = rim + roll + 0.0035, rim_y + np.minimum(-0.008, band - cut.turned / 1000)
    edge = 1 / ((np.abs(side) / 0.178) ** 2.6 + (np.abs(front) / 0.100) ** 2.6) ** (1 / 2.6)
    chest = np.maximum(front, 0.0) ** 1.5
    rest = ROWS - len(rows)
    crease = np.random.default_rng([seed, 0xF01D]).uniform(0, 2 * np.pi, 4)
    for k in range(1, rest + 1):
        s = k / rest
        slope, drop_down = np.clip(s / 0.62, 0, 1), np.clip((s - 0.62) / 0.38, 0, 1)
        reach = at_reach + (edge - at_reach) * slope + 0.008 * np.sin(0.5 * np.pi * drop_down)
        fall = (0.034 + 0.020 * chest) * slope + (0.030 - 0.006 * chest) * slope**3
        y = at_y - fall - 0.13 * drop_down**1.3
        point = np.stack([side * reach, y, AXIS_Z + front * reach], 1)
        # Folds run down from the neck and across from arm to arm.
        wave = np.sin(5 * turn + crease[0] + 2.5 * slope) * 0.6 + np.sin(9 * turn + crease[1])
        sag = lumps(point, 0.05, seed + 3) + 0.5 * wave * smooth(drop_down * 2)
        out = np.stack([0.4 * side, 0.8 + 0 * side, 0.5 * front], 1)
        rows.append(point + 0.0016 * cut.folds * min(4 * s, 1.0) * sag[:, None] * out)
    surface = join_rings(np.stack(rows), np.linspace(0, 0.7, COLUMNS + 1))
    return Garment(surface=surface, rim_y=rim_y, rim=rim)


def _reach(skin: Float64Array, turn: Float64Array, rim_y: Float64Array) -> Float64Array:
    """How far skin lies from the neck's axis at the neckline, smoothed round the neck."""
    around = np.arctan2(skin[:, 0], -(skin[:, 2] - AXIS_Z)) % (2 * np.pi)
    reach = np.hypot(skin[:, 0], skin[:, 2] - AXIS_Z)
    found = np.full(COLUMNS, np.nan)
    for k, (angle, y) in enumerate(zip(turn, rim_y, strict=True)):
        off = np.abs((around - angle + np.pi) % (2 * np.pi) - np.pi)
        here = (off < 0.16) & (np.abs(skin[:, 1] - y) < 0.010)
        if here.any():
            found[k] = reach[here].max()
    known = np.flatnonzero(~np.isnan(found))
    full = np.full(COLUMNS, 0.06)
    if len(known):
        full = np.interp(np.arange(COLUMNS), known, found[known], period=COLUMNS)
    for _ in range(3):
        full = np.maximum(full, 0.25 * np.roll(full, 1) + 0.5 * full + 0.25 * np.roll(full, -1))
    return full
