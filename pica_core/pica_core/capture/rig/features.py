"""Where a rig's mouth and eyes are, found from its shape and from what its shapes move.

    mouth    skin that an opening jaw pulls apart: the line where the lips touch
    eyes     eyeballs as a front view sees them between the lids
    scalp    skin above a hairline
    neck, ears    where the face model marks them; other rigs have none

Distances are those of an average head. A rig without jawOpen, or without eyeballs, lacks what hangs
on it.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import convolve

from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES, NUM_ARKIT
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.rig.mesh import MARKS, RigMesh
from pica_core.capture.triangles import (
    FRONT_CELL_M,
    FrontView,
    components,
    front_view,
    nearest,
    visibility,
)
from pica_core.errors import ShapeError
from pica_core.types import BoolArray, Float64Array, FloatArray, IntArray

HAIRLINE = (
    (0.0, 0.100), (25.0, 0.102), (45.0, 0.092), (62.0, 0.072), (72.0, 0.030),
    (80.0, 0.004), (90.0, 0.034), (118.0, 0.036), (132.0, -0.012), (155.0, -0.045), (180.0, -0.052),
)  # fmt: skip
"""Height of the hairline, metres above the ears, over the azimuth from the front in degrees."""


def hair_coverage(points: Float64Array) -> Float64Array:
    """How far above the hairline each point of a scalp lies: 0 at the line, 1 is 14 mm. ``[P]``."""
    azimuth = np.degrees(np.abs(np.arctan2(points[:, 0], points[:, 2] + 0.005)))
    line = np.interp(azimuth, *np.array(HAIRLINE).T)
    return np.clip((points[:, 1] - line) / 0.014, -1.0, 1.0)


UPPER_LIP_M, LOWER_LIP_M = 0.0075, 0.0095
"""Heights of the vermilion (Farkas 1994), where nothing else is known."""
HIDDEN = 0.004
"""Visibility at rest of what lies behind closed lips."""
LID_M = 0.0012
"""Skin so near to the eye opening is the lids' edge."""
FAR_M = 0.1
"""Distance to an eye opening where there is none."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Mouth:
    """The line where the lips touch at rest: height `y` and depth `z` over ascending `x`, metres.

    `half_m` is half the mouth's width, `centre_x` its middle.
    """

    half_m: float
    x: Float64Array
    y: Float64Array
    z: Float64Array
    centre_x: float

    def depth_in_lips(self, points: Float64Array) -> Float64Array:
        """0 at the vermilion border, 1 at the line of contact; below 0 on the skin. ``[n]``."""
        across = points[:, 0] - self.centre_x
        t = np.clip(np.abs(across) / self.half_m, 0.0, 1.0)
        rise = points[:, 1] - np.interp(points[:, 0], self.x, self.y)
        bow = (
            1
            - 0.22 * np.exp(-0.5 * (t / 0.10) ** 2)
            + 0.06 * np.exp(-0.5 * ((t - 0.22) / 0.12) ** 2)
        )
        upper = UPPER_LIP_M * np.maximum((1 - t**1.9) * bow, 0.02)
        lower = LOWER_LIP_M * np.maximum(1 - t**2.4, 0.02) ** 0.8
        depth = 1 - np.where(rise >= 0, rise / upper, -rise / lower)
        beyond = np.maximum(np.abs(across) - self.half_m, 0.0)
        behind = np.interp(points[:, 0], self.x, self.z) - points[:, 2]
        return np.where(behind > 0.03, -3.0, np.clip(depth - beyond / 0.0015, -3.0, 2.0))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Features:
    """What was found on a rig. Arrays are per welded vertex.

    Attributes:
        lips: How deep in the lips, as `Mouth.depth_in_lips`. ``[P]``.
        eye_gap_m: Distance in the front view to the nearest eye opening, 0 inside. ``[P]``.
        above_eye: True above the middle of the nearest eyeball. ``[P]``.
        nose_tip: Foremost point between eyes and mouth. ``[3]``.
        part: Part of each face, with the mouth's lining and the tongue told apart. ``[F]``.
        regions: Named vertex sets. bool ``[P]`` each.
    """

    mouth: Mouth | None
    lips: Float64Array
    eye_gap_m: Float64Array
    above_eye: BoolArray
    brow_y: float
    nose_tip: Float64Array
    part: IntArray
    regions: dict[str, BoolArray]


def _length(mesh: RigMesh, *names: str) -> Float64Array:
    """Largest displacement of each vertex over shapes whose name starts with one of these."""
    chosen = [k for k, name in enumerate(ARKIT_NAMES) if name.startswith(names)]
    return np.linalg.norm(mesh.motion_m[chosen], axis=2).max(0).astype(np.float64)


def find_mouth(mesh: RigMesh) -> Mouth | None:
    """The line where lips touch: skin close together that jawOpen pulls apart."""
    drop = -mesh.motion_m[ARKIT_INDEX["jawOpen"], :, 1].astype(np.float64)
    skin = mesh.of_part("skin")
    rest = mesh.rest_m
    if not skin.any() or drop[skin].max() < 0.003:
        return None
    eye_z = max((eye.centre_m[2] for eye in mesh.eyes), default=0.05)
    front = skin & (rest[:, 2] > eye_z - 0.02) & (np.abs(rest[:, 0]) < 0.05)
    front &= rest[:, 1] < min((eye.centre_m[1] for eye in mesh.eyes), default=0.02) - 0.02
    if not front.any():
        return None
    most = drop[front].max()
    low = np.flatnonzero(front & (drop > 0.5 * most))
    high = np.flatnonzero(front & (drop < 0.25 * most) & (drop > -1))
    if not len(low) or not len(high):
        return None
    partner, gap = nearest(rest[low], rest[high])
    limit = max(0.003, 2.0 * float(np.quantile(gap, 0.02)))
    touching = gap < limit
    if touching.sum() < 3:
        return None
    line = 0.5 * (rest[low[touching]] + rest[high[partner[touching]]])
    half = float(np.ptp(line[:, 0])) / 2 + 0.002
    centre = float(line[:, 0].max() + line[:, 0].min()) / 2
    edges = np.linspace(line[:, 0].min(), line[:, 0].max() + 1e-9, 10)
    place = np.digitize(line[:, 0], edges)
    pieces = [line[place == k] for k in np.unique(place)]
    # Of each piece the foremost half counts.
    rows = [piece[piece[:, 2] >= np.quantile(piece[:, 2], 0.5)].mean(0) for piece in pieces]
    knots = np.array(rows)[np.argsort([row[0] for row in rows])]
    return Mouth(half_m=half, x=knots[:, 0], y=knots[:, 1], z=knots[:, 2], centre_x=centre)


def _eye_gaps(mesh: RigMesh, view: FrontView, part: IntArray) -> tuple[Float64Array, BoolArray]:
    gap = np.full(len(mesh.rest_m), FAR_M)
    above = np.zeros(len(mesh.rest_m), np.bool_)
    is_eye = np.append(part == MATERIALS.index("eye"), False)[view.face]
    # A sample of skin that is missing lets the eye shine through: only whole patches count.
    around = convolve(is_eye.astype(np.int64), np.ones((5, 5), np.int64), mode="constant")
    rows, columns = np.nonzero(is_eye & (around >= 12))
    opening = np.stack([columns, rows], 1) * FRONT_CELL_M + view.origin_m + 0.5 * FRONT_CELL_M
    for eye in mesh.eyes:
        here = opening[np.abs(opening - eye.centre_m[:2]).max(1) < 1.3 * eye.radius_m]
        if not len(here):
            continue
        offset = mesh.rest_m - eye.centre_m
        near = np.flatnonzero(
            (np.abs(offset[:, :2]).max(1) < 2.2 * eye.radius_m) & (offset[:, 2] > 0)
        )
        _, distance = nearest(mesh.rest_m[near, :2], here)
        gap[near] = np.minimum(gap[near], np.maximum(distance - FRONT_CELL_M, 0.0))
        # The canthi lie on the line between lids: what is above is the upper lid.
        tilt = np.array([0, eye.centre_m[1]])
        if len(here) > 20:
            tilt = np.polyfit(here[:, 0], here[:, 1], 1)
        above[near] = mesh.rest_m[near, 1] > np.polyval(tilt, mesh.rest_m[near, 0])
    return gap, above


def _inner_parts(mesh: RigMesh, view: FrontView, mouth: Mouth | None) -> IntArray:
    """Parts of faces, with skin behind the lips as the mouth's lining."""
    part = mesh.part.copy()
    centre = mesh.rest_m[mesh.faces].mean(1)
    hidden = visibility([mesh.rest_m], mesh.faces) < HIDDEN
    tongue = part == MATERIALS.index("tongue")
    if tongue.any():
        # One material for gums and tongue: the tongue is what lies inside the arches.
        label = components(mesh.uv_faces, len(mesh.uv))[mesh.uv_faces[:, 0]]
        wide = np.abs(mesh.rest_m[mesh.faces[tongue].ravel(), 0]).max()
        for island in np.unique(label[tongue]):
            points = mesh.rest_m[mesh.faces[label == island].ravel()]
            inside = np.abs(points[:, 0]).max() < 0.7 * wide and np.ptp(points[:, 2]) > 0.02
            if not inside:
                part[label == island] = MATERIALS.index("mouth_bag")
    if mouth is not None:
        across = np.abs(centre[:, 0] - mouth.centre_x) < mouth.half_m + 0.016
        height = centre[:, 1] - float(np.mean(mouth.y))
        behind = view.nearest_z(centre) - centre[:, 2] > 0.007
        level = (height > -0.034) & (height < 0.026)
        lining = (part == 0) & across & level & behind & hidden & (centre[:, 2] > 0.0)
        part[lining] = MATERIALS.index("mouth_bag")
    return part


def find_features(mesh: RigMesh) -> Features:
    """Find mouth, eyes and regions of a rig."""
    view = front_view(mesh.rest_m, mesh.faces)
    mouth = find_mouth(mesh)
    part = _inner_parts(mesh, view, mouth)
    rest = mesh.rest_m
    of = replace(mesh, part=part).of_part
    gap, above = _eye_gaps(mesh, view, part)
    skin = of("skin")
    lips = mouth.depth_in_lips(rest) if mouth is not None else np.full(len(rest), -3.0)
    lips = np.where(skin | of("mouth_bag"), lips, -3.0)
    nothing = np.zeros(len(rest), np.bool_)
    eyeballs, lids, around = nothing.copy(), nothing, nothing
    for eye in mesh.eyes:
        eyeballs[eye.vertices] = True
    blink = _length(mesh, "eyeBlink", "eyeWide", "eyeSquint")
    if blink.max() > 0.001:
        moved = blink > 0.25 * blink.max()
        lids = skin & (moved & (gap < 0.012) | (gap < 0.003) if mesh.eyes else moved)
    interior = of("teeth", "tongue", "mouth_bag")
    if mouth is not None:
        middle = np.array([mouth.centre_x, float(np.mean(mouth.y))])
        box = np.abs(rest[:, :2] - middle) < [mouth.half_m + 0.016, 0.024]
        around = skin & box.all(1) & (rest[:, 2] > float(mouth.z.min()) - 0.03)
    eye_y = float(np.mean([eye.centre_m[1] for eye in mesh.eyes])) if mesh.eyes else 0.022
    mouth_y = float(np.mean(mouth.y)) if mouth is not None else eye_y - 0.067
    between = skin & (np.abs(rest[:, 0]) < 0.012)
    ridge = rest[between & (rest[:, 1] < eye_y) & (rest[:, 1] > mouth_y + 0.01)]
    tip = ridge[ridge[:, 2].argmax()] if len(ridge) else np.array([0, -0.02, 0.11])
    brow_weight = np.where(skin, _length(mesh, "brow"), 0.0) ** 4
    brow_y = eye_y + 0.018
    if brow_weight.sum() > 0:
        found = float(brow_weight @ rest[:, 1] / brow_weight.sum())
        brow_y = float(np.clip(found, eye_y + 0.012, eye_y + 0.024))
    moved = np.linalg.norm(mesh.motion_m, axis=2).max(0) > 0.001
    regions = {
        "face": skin & moved & (rest[:, 2] > 0),
        "lips": skin & (lips > -0.15),
        "lids": lids,
        "mouth_interior": interior,
        "mouth": interior | around | (skin & (lips > -0.15)),
        "eyeballs": eyeballs,
        "eyes": eyeballs | lids,
        "teeth": of("teeth"),
        "tongue": of("tongue"),
        "hair": of("hair"),
        "collar": of("collar"),
        "scalp": skin & (hair_coverage(rest) > 0),
        "left": rest[:, 0] > 0,
    }
    for name in MARKS:
        regions[name] = nothing.copy()
        regions[name][mesh.marks.get(name, [])] = True
    return Features(
        mouth=mouth,
        lips=lips,
        eye_gap_m=gap,
        above_eye=above,
        brow_y=brow_y,
        nose_tip=tip,
        part=part,
        regions=regions,
    )


class Limits:
    """What keeps values of a rig's shapes from pushing skin through skin."""

    def __init__(self, mesh: RigMesh, features: Features) -> None:
        self._corrective_close = _is_corrective(mesh)
        self._lids = [
            (index, _closing(mesh, features, side, index))
            for side, name in ((1.0, "Left"), (-1.0, "Right"))
            for index in (ARKIT_INDEX[f"eyeBlink{name}"],)
        ]

    def apply(self, arkit: npt.ArrayLike) -> FloatArray:
        """Values as they are posed. float32 ``[52]``.

        Raises:
            ShapeError: `arkit` does not have 52 values.
        """
        values = np.array(arkit, np.float32)
        if values.shape != (NUM_ARKIT,):
            raise ShapeError(f"arkit is {values.shape}; [{NUM_ARKIT}] is needed")
        if self._corrective_close:
            # Alone it is nonsense: lips cannot close further than the jaw has opened them.
            close, opening = ARKIT_INDEX["mouthClose"], ARKIT_INDEX["jawOpen"]
            values[close] = min(values[close], max(float(values[opening]), 0.0))
        for blink, closing in self._lids:
            # A glance down or a squint has closed a part of the way already.
            beyond = float(closing @ np.clip(values, 0.0, None)) - 1.0
            values[blink] -= np.clip(beyond, 0.0, max(float(values[blink]), 0.0))
        return values


def _is_corrective(mesh: RigMesh) -> bool:
    """Return True if mouthClose takes back a part of jawOpen, as ARKit's does."""
    opened = mesh.motion_m[ARKIT_INDEX["jawOpen"], :, 1]
    closed = mesh.motion_m[ARKIT_INDEX["mouthClose"], :, 1]
    if not closed.any() or not opened.any():
        return False
    at = np.abs(closed) > 0.3 * np.abs(closed).max()
    return bool(np.mean(closed[at] * opened[at] < 0) > 0.6)


def _closing(mesh: RigMesh, features: Features, side: float, blink: int) -> Float64Array:
    """How far each shape at 1 closes the lids of an eye, where its blink at 1 is 1. ``[52]``."""
    rest, edge = mesh.rest_m, features.regions["lids"] & (features.eye_gap_m < LID_M)
    eyes = [eye for eye in mesh.eyes if eye.side == side]
    closing = np.zeros(NUM_ARKIT)
    for eye in eyes:
        middle = edge & (np.abs(rest[:, 0] - eye.centre_m[0]) < 0.5 * eye.radius_m)
        upper, lower = middle & features.above_eye, middle & ~features.above_eye
        if upper.any() and lower.any():
            rise = [mesh.motion_m[:, lid, 1].mean(1, dtype=np.float64) for lid in (upper, lower)]
            closing = rise[1] - rise[0]
    return closing / closing[blink] if closing[blink] > 0.002 else np.zeros(NUM_ARKIT)
