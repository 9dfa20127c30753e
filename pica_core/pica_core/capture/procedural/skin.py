"""The skin chart at rest: rows and columns of the UV square become a face with lips and lids.

Rows follow the features: one runs along each lid margin, each vermilion border and each lip's
contact line, so borders are crisp at any density. Between those anchor rows heights are
interpolated per column; in depth the base comes from the distance field (`surface`), and lids and
lips are laid over it.

All lengths in this module are millimetres.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pica_core.capture.procedural.identity import FaceShape
from pica_core.capture.procedural.layout import EYE_ROW, MIDLINE_COLUMN, MOUTH_ROW, Chart
from pica_core.capture.procedural.sculpt import relief
from pica_core.capture.procedural.surface import EYE_RADIUS, EYE_Y, HeadField, cast, gradient
from pica_core.types import BoolArray, Float64Array

CREASE_ROW = 60
"""Row of the fold above the upper lid."""
LOWER_FOLD_ROW = 82
"""Row where the lower lid runs out into the cheek."""
UPPER_BORDER_ROW = 112
"""Row of the upper vermilion border."""
UPPER_CONTACT_ROW = 119
"""Row where the upper lip touches the lower one."""
LOWER_CONTACT_ROW = 130
"""Row where the lower lip touches the upper one."""
LOWER_BORDER_ROW = 139
"""Row of the lower vermilion border."""
SUBNASALE_ROW = 107
"""Row under the nose where the upper lip begins."""
CHIN_ROW = 151
"""Row around the lowest point of the chin."""
INNER_CANTHUS_COLUMN = 20.5
"""Columns from the midline where the eye slit begins."""
MOUTH_CORNER_COLUMN = 34.5
"""Columns from the midline where the mouth slit ends."""
OUTER_CANTHUS_COLUMN = 58.5
"""Columns from the midline where the eye slit ends."""
FRONT_COLUMNS = 62.0
"""Columns beside the midline whose rays run straight forward; the others turn to the back."""
LID_THICKNESS = 1.7
"""Eyeball surface to the outside of a lid."""


def smoothstep(low: float, high: float, value: npt.ArrayLike) -> Float64Array:
    """0 below `low`, 1 above `high`, smooth between."""
    t = np.clip((np.asarray(value, np.float64) - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def bump(value: npt.ArrayLike, centre: float, width: float) -> Float64Array:
    """A Gaussian of unit height; `width` is its standard deviation."""
    return np.exp(-0.5 * ((np.asarray(value, np.float64) - centre) / width) ** 2)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Skin:
    """The skin at rest and the coordinates that shapes and appearance are written in.

    Attributes:
        points: Rest positions, head frame, mm. ``[R, C, 3]``.
        mouth_half: Half the mouth's width, mm.
        eye_corners: Inner and outer canthus |x|, mm.
        mouth_hole, eye_hole: Missing quads of the slits. bool ``[R - 1, C - 1]``.
    """

    points: Float64Array
    mouth_half: float
    eye_corners: tuple[float, float]
    mouth_hole: BoolArray
    eye_hole: BoolArray


class EyeSurface:
    """Where lids glide: the eyeball, widened by the lid, melting into the socket around it.

    Frontal coordinates: `u` mm outwards from the pupil (towards the temple), `y` mm above the ear
    axis. Lids move in `y` only, and depth follows from here, so a lid can never leave the eyeball
    or enter it.
    """

    def __init__(self, field: HeadField) -> None:
        self.centre = field.eye_centre
        x, y, _ = field.eye_centre
        grid_u, grid_y = np.meshgrid(np.linspace(-19, 20, 14), np.linspace(-14, 15, 11))
        u, v = grid_u.ravel(), grid_y.ravel()
        origin = np.stack([x + u, y + v, np.zeros_like(u)], -1)
        forward = np.broadcast_to([0.0, 0.0, 1.0], origin.shape)
        depth = cast(field, origin, forward)[:, 2]
        self._coefficients = np.linalg.lstsq(self._basis(u, v), depth, rcond=None)[0]

    @staticmethod
    def _basis(u: Float64Array, v: Float64Array) -> Float64Array:
        powers = [u**i * v**j for i in range(5) for j in range(5 - i)]
        return np.stack(powers, -1)

    def socket(self, u: Float64Array, y: Float64Array) -> Float64Array:
        """Depth of the socket without an eyeball, mm."""
        u = np.clip(u, -20, 21)
        v = np.clip(y - self.centre[1], -15, 16)
        return self._basis(u, v) @ self._coefficients

    def depth(self, u: Float64Array, y: Float64Array, thickness: npt.ArrayLike) -> Float64Array:
        """Depth z of a lid point that lies `thickness` mm above the eyeball, mm."""
        v = y - self.centre[1]
        radius = EYE_RADIUS + np.asarray(thickness, np.float64)
        square = radius**2 - u**2 - v**2
        # A sphere that turns into a falling cone outside, so that it has a depth everywhere.
        reach = np.sqrt(u**2 + v**2)
        edge = 0.8 * radius
        ball = np.where(
            reach < edge, np.sqrt(np.maximum(square, 0.0)), 0.6 * radius - 1.333 * (reach - edge)
        )
        ball = self.centre[2] + ball
        socket = (
            self.socket(u, y) - 1.0 - 1.3 * np.maximum(LID_THICKNESS - np.asarray(thickness), 0.0)
        )
        k = 3.0
        h = np.maximum(k - np.abs(ball - socket), 0.0) / k
        return np.maximum(ball, socket) + 0.25 * h * h * k


def front_x(face: FaceShape, reach: npt.ArrayLike) -> Float64Array:
    """|x| in mm of front columns by their distance from the midline in columns.

    Slits end on the same columns in every identity.
    """
    middle = 0.5 * face.eye_distance
    inner, outer = middle - 0.52 * face.eye_width, middle + 0.48 * face.eye_width
    at = [0.0, INNER_CANTHUS_COLUMN, MOUTH_CORNER_COLUMN, OUTER_CANTHUS_COLUMN, FRONT_COLUMNS]
    x = [0.0, inner, 0.5 * face.mouth_width, outer, outer + 2.8]
    return np.interp(np.asarray(reach, np.float64), at, x)


def lid_lines(
    face: FaceShape, corners: tuple[float, float], u: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Heights of the upper and lower lid margin at rest, mm, over `u` mm outwards from the pupil.

    Outside the corners (|x| of inner and outer canthus, mm) both run on together.
    """
    inner, outer = corners[0] - 0.5 * face.eye_distance, corners[1] - 0.5 * face.eye_distance
    t = (u - inner) / (outer - inner)
    inside = np.clip(t, 0.0, 1.0)
    axis = EYE_Y - 1.2 + face.eye_tilt * (np.clip(t, -0.3, 1.3) - 0.35)
    # The upper lid peaks nasally of its middle, the lower one dips temporally.
    upper = (inside**0.62 * (1 - inside) ** 0.72) * 2.52
    lower = (inside**0.85 * (1 - inside) ** 0.62) * 2.75
    opening = face.eye_opening
    return axis + 0.59 * opening * upper, axis - 0.41 * opening * lower


def mouth_lines(field: HeadField, half: float, x: Float64Array) -> dict[str, Float64Array]:
    """Heights of vermilion borders and contact line at rest over x, mm; corners are at `half`."""
    t = np.clip(np.abs(x) / half, 0.0, 1.0)
    y = field.mouth_y
    contact = y + 0.9 * bump(t, 0.0, 0.13) - 0.9 * bump(t, 0.36, 0.22) - 0.4 * t**3
    # Cupid's bow: two peaks beside the dip under the philtrum.
    bow = 1.0 - 0.26 * bump(t, 0.0, 0.10) + 0.07 * bump(t, 0.22, 0.12)
    upper = np.maximum((1.0 - t**1.7) * bow, 0.0) * field.face.upper_lip
    lower = np.maximum(1.0 - t**2.6, 0.0) ** 0.8 * field.face.lower_lip
    return {"contact": contact, "upper": contact + upper, "lower": contact - lower}


def _heights(
    field: HeadField, chart: Chart, half: float, corners: tuple[float, float], x: Float64Array
) -> Float64Array:
    """Heights of all rows in all front columns. ``[R, C]``."""
    face, ax = field.face, np.abs(x)
    u = ax - 0.5 * face.eye_distance
    upper_lid, lower_lid = lid_lines(face, corners, u)
    reach = smoothstep(24.0, 8.0, np.abs(u + 1))  # folds follow the lid near the eye only
    # The slit's edges lie on the margins; beyond the corners the two rows part a little.
    outside = np.maximum(np.maximum(corners[0] - ax, ax - corners[1]), 0.0)
    beside_eye = 0.05 + 0.75 * smoothstep(0.0, 7.0, outside)
    mouth = mouth_lines(field, half, x)
    # Beyond the corner the lips' rows open out again into cheek, a little more per column.
    past = np.maximum(ax - half + 4.0, 0.0)
    spread = 8.0 * (1.0 - np.exp(-((past / 9.0) ** 1.5)))
    parted = 8.0 * (1.0 - np.exp(-((np.maximum(ax - half, 0.0) / 9.0) ** 1.2)))
    # Lips press into each other by a hair's breadth, so that nothing shines through a closed mouth.
    closed = -0.06 + 0.12 * smoothstep(0.84 * half, 0.97 * half, ax)
    closed = closed + 0.08 * smoothstep(half, half + 1.6, ax)
    subnasale = field.subnasale_y
    wing = smoothstep(20.0, 12.0, ax)
    anchors: list[tuple[float, Float64Array]] = [
        (40, np.full_like(x, 60.0)),
        (50, EYE_Y + face.brow_height + 8.0 + 0 * x),
        (56, EYE_Y + face.brow_height - 2.0 + 0 * x),
        (CREASE_ROW, np.maximum(upper_lid + 3.6 + 1.8 * reach, EYE_Y + 6.5)),
        (EYE_ROW, upper_lid + beside_eye),
        (EYE_ROW + 1, lower_lid - beside_eye),
        (LOWER_FOLD_ROW, lower_lid - 9.5 + 1.5 * reach),
        (94, subnasale + 13.5 + 0 * x),
        (101, subnasale + 3.0 + 0.8 * (1 - wing)),
        (SUBNASALE_ROW, subnasale - 1.2 - 2.2 * (1 - wing)),
        (UPPER_BORDER_ROW, mouth["upper"] + closed * 4.0 + spread),
        (UPPER_CONTACT_ROW, mouth["contact"] + closed * 2.5 + 0.45 * parted),
        (MOUTH_ROW, mouth["contact"] + closed * 0.5 + 0.05 * parted),
        (MOUTH_ROW + 1, mouth["contact"] - closed * 0.5 - 0.05 * parted),
        (LOWER_CONTACT_ROW, mouth["contact"] - closed * 2.5 - 0.45 * parted),
        (LOWER_BORDER_ROW, mouth["lower"] - closed * 4.0 - spread),
        (146, field.below(-71.0) + 0 * x),
        (CHIN_ROW, field.chin_y + 5.0 + 0 * x),
        (155, field.chin_y - 14.0 + 0 * x),
        (163, -140.0 + 0 * x),
    ]
    rows = np.array([row for row, _ in anchors])
    values = np.stack([value for _, value in anchors])
    at = np.clip(np.searchsorted(rows, chart.rows, side="right") - 1, 0, len(rows) - 2)
    t = ((chart.rows - rows[at]) / (rows[at + 1] - rows[at]))[:, None]
    return values[at] + t * (values[at + 1] - values[at])


def _rays(
    field: HeadField, chart: Chart, half: float, corners: tuple[float, float]
) -> tuple[Float64Array, Float64Array]:
    """Origins and directions of the rays of every skin vertex. Two ``[R, C, 3]``."""
    n = chart.columns - MIDLINE_COLUMN
    face, side, n = field.face, np.sign(n), np.abs(n)
    q = np.clip((n - FRONT_COLUMNS) / (127.5 - FRONT_COLUMNS), 0.0, 1.0)
    edge = float(front_x(face, FRONT_COLUMNS))
    bulge = 0.8 * (127.5 - FRONT_COLUMNS) * q * (1 - q) ** 3  # goes on at about the front's pace
    x0 = np.where(q <= 0, front_x(face, n), edge + bulge)
    x0 = x0 * (1 - q**4) * side
    turn = np.pi * q * (1.0 - (1.0 - q) ** 3) * side
    rows = chart.rows.astype(np.float64)[:, None]
    y_front = _heights(field, chart, half, corners, np.where(q > 0, side * (edge + 32 * q), x0))
    # The neck is narrower than the face: its columns lie closer together.
    narrow = 1.0 - max(1.0 - 0.66 * face.neck_breadth / 2 / edge, 0.0) * smoothstep(147, 158, rows)
    # Behind the ears rows level out: the row of the chin climbs to the jaw angle and the nape.
    y_back = np.interp(
        rows,
        [40, 56, 71, 82, 101, 124, 140, 151, 155, 163],
        [58, 36, 18, 6, -14, -36, -54, -78, -94, -140],
    )
    back = smoothstep(0.0, 0.5, q)[None]
    y0 = y_front * (1 - back) + y_back * back
    # The cranium fans out to the crown; under nose and chin `_relax` finds the surface that rays
    # cannot see.
    fan = np.clip((40.0 - rows) / 40.0, 0.0, 1.0)
    lift = np.radians(np.interp(rows, [0, 40, 56, 200], [88.5, 10, 0, 0]))
    y0 = np.where(fan > 0, 60.0 - 10.0 * fan, y0)
    shrink = np.cos(np.radians(np.interp(rows, [0, 40], [88.5, 0])))
    z0 = np.interp(q, [0, 0.2, 0.5, 1], [38, 28, 2, -12])[None]
    z0 = z0 * shrink + 4.0 * (1 - shrink)
    origin = np.stack(np.broadcast_arrays(x0[None] * shrink * narrow, y0, z0), -1)
    direction = np.stack(
        np.broadcast_arrays(
            np.cos(lift) * np.sin(turn)[None], np.sin(lift), np.cos(lift) * np.cos(turn)[None]
        ),
        -1,
    )
    return origin, direction


def _relax(
    field: HeadField, chart: Chart, points: Float64Array, half: float, outer: float
) -> Float64Array:
    """Even out the grid where the surface turns away from the rays: under the nose, under the
    chin, on the neck.

    Laplacian smoothing alternates with stepping back onto the field. Rows that carry features stay
    where they are.
    """
    rows = chart.rows.astype(np.float64)[:, None]
    ax = np.abs(points[..., 0])
    front = points[..., 2] > 60
    nose = smoothstep(91, 96, rows) * smoothstep(112, 108, rows) * smoothstep(27, 19, ax) * front
    below = smoothstep(144, 150, rows) * np.ones_like(ax)
    behind = (
        smoothstep(45.0, 20.0, points[..., 2])
        * smoothstep(60, 90, rows)
        * smoothstep(164, 160, rows)
    )
    # Beside mouth and eyes their rows lie close together; out there nothing needs them so.
    beside_mouth = smoothstep(half + 3.0, half + 12.0, ax) * smoothstep(100, 108, rows)
    beside_eye = smoothstep(outer + 5.0, outer + 14.0, ax) * smoothstep(44, 54, rows)
    beside = np.maximum(beside_mouth, beside_eye * smoothstep(104, 96, rows))
    free = np.clip(np.maximum(np.maximum(nose, below), np.maximum(behind, beside)), 0, 1)
    free[0] = free[-1] = 0.0
    step = 0.6
    chosen = free > 1e-3
    for sweep in range(70):
        padded = np.concatenate([points[:, -2:-1], points, points[:, 1:2]], 1)  # round the seam
        vertical = 0.5 * (points[:-2] + points[2:])
        sideways = 0.5 * (padded[1:-1, :-2] + padded[1:-1, 2:])
        target = points.copy()
        target[1:-1] = 0.5 * (vertical + sideways)
        points = points + step * free[..., None] * (target - points)
        if sweep % 5 == 4 or sweep > 66:
            p = points[chosen]
            value = field(p)
            points[chosen] = p - np.clip(value, -3, 3)[:, None] * gradient(field, p)
    return points


def _lay_lips(field: HeadField, chart: Chart, half: float, points: Float64Array) -> None:
    """Raise the lips over the muzzle and roll their inner edges into the mouth, in place."""
    rows = chart.rows
    x = points[..., 0]
    ax = np.abs(x)
    t = np.clip(ax / half, 0.0, 1.0)
    front = (ax < half + 40) & (points[..., 2] > 30)
    pout = 4.5 * field.face.lip_fullness * np.maximum(1 - t**2.4, 0.0) ** 0.8
    s_upper = (rows[:, None] - UPPER_BORDER_ROW) / (UPPER_CONTACT_ROW - UPPER_BORDER_ROW)
    s_lower = (LOWER_BORDER_ROW - rows[:, None]) / (LOWER_BORDER_ROW - LOWER_CONTACT_ROW)
    # Profile from the skin above (below 0) over the border (0) to the contact line (1): skin rises
    # towards the lip, the lip is full in its middle and falls back to where lips meet.
    tubercle = 1.0 + 0.18 * bump(t, 0.0, 0.16) - 0.10 * bump(t, 0.3, 0.12)
    pillows = 1.0 - 0.10 * bump(t, 0.0, 0.12) + 0.08 * bump(t, 0.32, 0.16)
    for s, gain, is_lip in (
        (s_upper, 1.0 * tubercle, rows <= MOUTH_ROW),
        (s_lower, 1.05 * pillows, rows > MOUTH_ROW),
    ):
        rise = 0.52 * smoothstep(-0.8, 0.25, s)
        belly = 0.62 * np.sin(np.pi * np.clip((s + 0.08) / 1.16, 0.0, 1.0)) ** 1.2
        fall = 0.60 * smoothstep(0.6, 1.05, s)
        profile = rise + belly - fall - 0.15 * smoothstep(1.0, 1.3, s)
        points[..., 2] += np.where(front & is_lip[:, None], gain * pout * profile, 0.0)
    # Inner edges: back into the mouth and away from each other.
    depth = 0.1 + 7.3 * np.maximum(1 - t**3, 0.0) ** 0.7
    depth = np.where(t < 1, depth, 0.1 * smoothstep(half + 3.2, half, ax))
    k_upper = np.clip((rows - UPPER_CONTACT_ROW) / (MOUTH_ROW - UPPER_CONTACT_ROW), 0, 1)
    k_upper = np.where(rows <= MOUTH_ROW, k_upper, 0.0)[:, None]
    k_lower = np.clip((LOWER_CONTACT_ROW - rows) / (LOWER_CONTACT_ROW - MOUTH_ROW - 1), 0, 1)
    k_lower = np.where(rows > MOUTH_ROW, k_lower, 0.0)[:, None]
    taper = np.where(front, depth, 0.0)
    points[..., 2] -= taper * (k_upper + k_lower)
    points[..., 1] += 0.32 * taper * (k_upper**1.5 - k_lower**1.5)


def build_skin(field: HeadField, chart: Chart) -> Skin:
    """Make the skin of one identity at rest."""
    slit_ends = (MOUTH_CORNER_COLUMN, INNER_CANTHUS_COLUMN, OUTER_CANTHUS_COLUMN)
    half, inner, outer = (float(front_x(field.face, column)) for column in slit_ends)
    corners = inner, outer
    origin, direction = _rays(field, chart, half, corners)
    points = cast(field, origin.reshape(-1, 3), direction.reshape(-1, 3)).reshape(origin.shape)
    points = _relax(field, chart, points, half, corners[1])
    # The neck's lower end draws in under the collar.
    end = smoothstep(155.0, 163.0, chart.rows)[:, None]
    points[..., 0] *= 1.0 - 0.14 * end
    points[..., 2] -= 0.14 * end * (points[..., 2] + 30.0)
    height = relief(field, half, points)
    chosen = np.abs(height) > 1e-4
    points[chosen] += height[chosen][:, None] * gradient(field, points[chosen])
    _lay_lips(field, chart, half, points)
    reach = np.abs(chart.columns - MIDLINE_COLUMN)
    low, high = np.minimum(reach[:-1], reach[1:]), np.maximum(reach[:-1], reach[1:])
    mouth_columns = high <= MOUTH_CORNER_COLUMN
    eye_columns = (low >= INNER_CANTHUS_COLUMN) & (high <= OUTER_CANTHUS_COLUMN)
    row_of_eye = chart.rows[:-1] == EYE_ROW
    row_of_mouth = chart.rows[:-1] == MOUTH_ROW
    return Skin(
        points=points,
        mouth_half=half,
        eye_corners=corners,
        mouth_hole=row_of_mouth[:, None] & mouth_columns[None],
        eye_hole=row_of_eye[:, None] & eye_columns[None],
    )
