"""The head without its small parts, as a signed distance field, and rays that find its surface.

A head is a smooth union of a few anatomical masses (cranium, face, jaw, cheekbones, brow ridge,
nose, neck) minus eye sockets and temples. Grid lines of the skin chart become rays that start
inside the head; where a ray leaves the field, a vertex lies. Lips, lids and ears are added
afterwards (`skin`, `lids`, `parts`).

Everything here is in millimetres in the head frame (+x the subject's left, +y up, +z out of the
face).
"""

import numpy as np
import numpy.typing as npt

from pica_core.capture.procedural.identity import FaceShape
from pica_core.types import Float64Array

SELLION_Y = 30.0
"""Height of the nasal root above the ear axis (chosen from Farkas' facial profile)."""
EYE_Y = 22.0
"""Height of the pupils above the ear axis."""
EYE_RADIUS = 12.1
"""Eyeball radius (Bekerman et al. 2014: about 24 mm in diameter)."""


def smooth_min(a: Float64Array, b: Float64Array, k: float) -> Float64Array:
    """Union of two fields, rounded over a length of `k` mm (quadratic polynomial blend)."""
    h = np.maximum(k - np.abs(a - b), 0.0) / k
    return np.minimum(a, b) - 0.25 * h * h * k


def smooth_max(a: Float64Array, b: Float64Array, k: float) -> Float64Array:
    """Intersection of two fields, rounded over `k` mm."""
    return -smooth_min(-a, -b, k)


def _length(v: Float64Array) -> Float64Array:
    return np.sqrt(np.einsum("...i,...i->...", v, v))


def _ellipsoid(
    p: Float64Array, centre: tuple[float, ...], radii: tuple[float, ...]
) -> Float64Array:
    q = p - np.asarray(centre)
    r = np.asarray(radii)
    k0, k1 = _length(q / r), _length(q / (r * r))
    return k0 * (k0 - 1.0) / np.maximum(k1, 1e-9)


def _cone(
    p: Float64Array, a: tuple[float, ...], b: tuple[float, ...], radius_a: float, radius_b: float
) -> Float64Array:
    """Distance to a capsule whose radius changes linearly from `a` to `b` (a little inexact)."""
    start, end = np.asarray(a), np.asarray(b)
    axis = end - start
    t = np.clip((p - start) @ axis / (axis @ axis), 0.0, 1.0)
    gap = _length(p - start - t[..., None] * axis)
    return gap - (radius_a + (radius_b - radius_a) * t)


class _Curve:
    """A smooth curve through (at, value), sampled densely; constant beyond its ends."""

    def __init__(self, at: list[float], values: list[float], smoothing: float = 4.0) -> None:
        order = np.argsort(at)
        self._at = np.arange(min(at) - 20.0, max(at) + 20.0, 0.5)
        raw = np.interp(self._at, np.asarray(at)[order], np.asarray(values, np.float64)[order])
        half = int(6 * smoothing)
        kernel = np.exp(-0.5 * (0.5 * np.arange(-half, half + 1) / smoothing) ** 2)
        self._values = np.convolve(np.pad(raw, half, mode="edge"), kernel / kernel.sum(), "valid")

    def __call__(self, at: Float64Array) -> Float64Array:
        return np.interp(at, self._at, self._values)


class HeadField:
    """The signed distance field of one identity's head; negative inside."""

    def __init__(self, face: FaceShape) -> None:
        self.face = face
        self.face_scale = face.face_height / 120.0
        self.eye_centre = (0.5 * face.eye_distance, EYE_Y, 76.5)
        self.subnasale_y = SELLION_Y - face.nose_length
        self.mouth_y = self.below(-43.5)
        self.chin_y = self.below(-90.0)
        self._sections = self._face_sections(face)

    def below(self, y: float) -> float:
        """A height below the sellion, given for a face of 120 mm, in this face."""
        return SELLION_Y + (y - SELLION_Y) * self.face_scale

    def __call__(self, points: Float64Array) -> Float64Array:
        """Signed distance in mm at points ``[..., 3]``."""
        f = self.face
        p = points.copy()
        p[..., 0] = np.abs(p[..., 0])  # both sides at once
        return self._nose(p, self._masses(p, f), f)

    def _masses(self, p: Float64Array, f: FaceShape) -> Float64Array:
        breadth, length = 0.5 * f.head_breadth, f.head_length
        # Cranium: two ellipsoids, brow to vertex and the fuller, lower back of the head.
        d = _ellipsoid(p, (0, 50, 4), (breadth, 80, 0.5 * length - 2))
        d = smooth_min(d, _ellipsoid(p, (0, 30, -26), (breadth - 6, 72, 0.5 * length - 30)), 26)
        # Forehead: flatter than an ellipsoid and nearly upright.
        d = smooth_min(d, _ellipsoid(p, (0, 58, 40), (60, 46, 53.5)), 20)
        d = smooth_min(d, self._face(p), 16)
        # Cheekbones: a soft ridge from beside the nose to the ear, low under the skin.
        cheek = 0.5 * f.cheekbone_breadth
        d = smooth_min(d, _cone(p, (30, -3, 80), (cheek - 15, 3, 48), 9.5, 11.0), 22)
        d = smooth_min(d, _ellipsoid(p, (cheek - 13, 0, 14), (11.0, 15.0, 32.0)), 26)
        # Malar fat pad and the soft cheek beside the mouth.
        soft = f.cheek_fullness
        d = smooth_min(
            d, _ellipsoid(p, (34, self.below(-24), 64), (21 * soft, 27, 25.0 * soft)), 24
        )
        # Brow ridge and glabella.
        ridge = 1.3 * f.brow_ridge
        d = smooth_min(d, _cone(p, (8, 37, 87.5 + ridge), (44, 41, 70 + 0.6 * ridge), 8.5, 10), 14)
        # Orbits: the hollow the lids sit in; temples: shallow hollows behind the brow's end.
        x, y, _ = self.eye_centre
        socket = _ellipsoid(p, (x - 1.0, y - 1.0, 103), (19.0, 13.0, 17.5))
        d = smooth_max(d, -socket, 12)
        d = smooth_max(d, -_ellipsoid(p, (0.5 * f.head_breadth + 16, 40, 54), (17, 28, 28)), 30)
        return smooth_min(d, self._neck(p, f), 20)

    def _face(self, p: Float64Array) -> Float64Array:
        """The face without its features: horizontal sections between profile and widest place."""
        x, y, z = p[..., 0], p[..., 1], p[..., 2]
        front, width, middle, power = (curve(y) for curve in self._sections)
        ahead = np.where(z > middle, front - middle, middle + 62.0)
        sideways, forward = np.abs(x) / width, np.abs(z - middle) / ahead
        size = (sideways**power + forward**power + 1e-9) ** (1.0 / power)
        reach = np.hypot(x, z - middle)
        d = 0.82 * (reach - reach / np.maximum(size, 1e-3))
        # The lower border of the mandible, from the jaw's angle to the chin.
        jaw_y = self.below(-66.0)
        slope = (self.chin_y - 2.0 - jaw_y) / 64.0
        border = (jaw_y + slope * np.clip(z - 24.0, -60.0, 80.0) - y) / np.hypot(1.0, slope)
        d = smooth_max(d, border, 18)
        return smooth_max(d, y - 70.0, 20)

    def _face_sections(self, f: FaceShape) -> tuple[_Curve, _Curve, _Curve, _Curve]:
        """Profile, half width, depth of the widest place and roundness, by height.

        Depths of nasion, subnasale and gnathion follow from their distances to the tragion and the
        breadth between the tragi (Farkas 1994: 121, 130, 147 and 142 mm for men).
        """
        cheek, jaw = 0.5 * f.cheekbone_breadth, 0.5 * f.jaw_breadth
        chin = 0.5 * f.chin_breadth
        pogonion = f.chin_projection
        at = [self.below(y) for y in (-104, -92, -84, -76, -66, -54, -43.5, -32, -20, -8, 6)]
        at += [20.0, 30.0, 40.0, 52.0, 70.0]
        front = [88, 95 + pogonion, 99.5 + pogonion, 99.5 + pogonion, 97.5 + 0.4 * pogonion, 99]
        front += [101.5, 101.5, 99.5, 95.5, 92.0, 90.0, 91.5, 94.0, 94.5, 90.0]
        width = [chin * 1.1, chin * 1.45, chin * 1.75, 0.66 * jaw + 0.55 * chin, jaw]
        width += [jaw + 3.0, jaw + 3.0 + 0.25 * (cheek - jaw), jaw + 3.0 + 0.5 * (cheek - jaw)]
        width += [jaw + 2.0 + 0.75 * (cheek - jaw), cheek - 2.0, cheek - 1.0, cheek - 1.5]
        width += [cheek - 1.0, cheek, cheek + 1.0, cheek]
        middle = [52.0, 50, 44, 34, 24, 16, 12, 12, 12, 12, 12, 10, 8, 6, 4, 2]
        power = [2.1, 2.1, 2.05, 2.0, 1.95, 1.95, 1.95, 2.0, 2.05, 2.15, 2.25, 2.3, 2.3, 2.3, 2.3]
        power += [2.3]
        return (_Curve(at, front), _Curve(at, width), _Curve(at, middle), _Curve(at, power))

    def _neck(self, p: Float64Array, f: FaceShape) -> Float64Array:
        """A column that leans back on its way down, sternomastoids, larynx and trapezius."""
        neck = 0.5 * f.neck_breadth
        d = _cone(p, (0, -30, -16), (0, -170, -40), neck - 5, neck - 1)
        d = smooth_min(d, _cone(p, (0, -88, 22), (0, -150, 2), 15, 20), 26)
        adam = 8.0 + 1.5 * f.brow_ridge
        deep = 5.0 * max(1.0 - f.brow_ridge, 0.0)
        d = smooth_min(d, _cone(p, (0, -106, 24 - deep), (0, -124, 19 - deep), adam, adam), 24)
        d = smooth_min(d, _cone(p, (neck + 1, -22, -16), (14, -165, 0), 10, 9), 26)
        return smooth_min(d, _cone(p, (12, -46, -42), (46, -172, -62), 16, 30), 30)

    def _nose(self, p: Float64Array, d: Float64Array, f: FaceShape) -> Float64Array:
        base_z = 99.0  # of the face around the subnasale
        tip_y = self.subnasale_y + 10.5 + f.nose_tip_lift
        tip_z = base_z + f.nose_protrusion - 6.2  # centre of a tip of 6.5 mm radius
        wing_x = 0.5 * f.nose_breadth - 4.6
        wing_y = self.subnasale_y + 5.6
        bridge_z = 87.0 + 3.4 * f.nose_bridge
        middle = (0, 0.5 * (tip_y + SELLION_Y) + 2, 0.5 * (bridge_z + tip_z) - 0.2)
        # Dorsum, and side walls that carry it down into the cheeks.
        bridge = _cone(p, (0, SELLION_Y + 1, bridge_z - 0.5), middle, 5.2, 5.8)
        bridge = smooth_min(bridge, _cone(p, middle, (0, tip_y + 2, tip_z), 6.0, 6.4), 8)
        walls = _cone(p, (6.0, 18, 85), (wing_x - 1.5, wing_y + 6, base_z - 1), 6.0, 7.5)
        d = smooth_min(d, walls, 14)
        d = smooth_min(d, bridge, 9)
        side = _cone(p, (3.5, middle[1], middle[2] - 3), (5.5, tip_y + 2, tip_z - 5.5), 5.0, 5.6)
        d = smooth_min(d, side, 8)
        # Tip: two domes of cartilage under one skin.
        tip = _ellipsoid(p, (2.4, tip_y, tip_z), (6.0, 5.6, 6.5))
        d = smooth_min(d, tip, 7)
        wing = _ellipsoid(p, (wing_x, wing_y, base_z + 2.0), (4.4, 5.6, 8.0))
        d = smooth_min(d, wing, 4.5)
        rim = _cone(p, (wing_x, wing_y + 1.0, base_z + 4), (3.2, tip_y - 0.5, tip_z - 1), 4.4, 5.4)
        d = smooth_min(d, rim, 7)
        # Columella, then the nostrils cut out beside it: long openings that lean together in front.
        columella = _cone(
            p, (0, tip_y - 5.0, tip_z - 1), (0, self.subnasale_y + 0.5, base_z + 1.5), 2.6, 3.6
        )
        d = smooth_min(d, columella, 4)
        start = (wing_x - 3.4, self.subnasale_y + 1.2, base_z + 3.0)
        end = (4.4, self.subnasale_y + 2.6 + 0.4 * f.nose_tip_lift, tip_z - 2.0)
        nostril = _cone(p, start, end, 3.2, 2.3)
        return smooth_max(d, -nostril, 2.2)


def cast(
    field: HeadField, origin: Float64Array, direction: Float64Array, reach: npt.ArrayLike = 150.0
) -> Float64Array:
    """Where rays out of the head leave it for the last time, mm. float64 ``[N, 3]``.

    Origins lie inside; directions have unit length. The search starts `reach` mm from the origin,
    which is short where the ray would meet another part.
    """
    distance = np.broadcast_to(np.asarray(reach, np.float64), len(origin)).copy()
    moving = np.arange(len(origin))
    for _ in range(48):  # sphere tracing from outside; 0.85 because blends overestimate a little
        value = field(origin[moving] + distance[moving, None] * direction[moving])
        distance[moving] = np.maximum(distance[moving] - np.clip(0.85 * value, -4.0, 40.0), 1.0)
        moving = moving[np.abs(value) > 1e-3]
        if len(moving) == 0:
            break
    return origin + distance[:, None] * direction


_CORNERS = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])


def gradient(field: HeadField, points: Float64Array, step: float = 0.5) -> Float64Array:
    """Outward unit normals ``[N, 3]`` by differences over `step` mm about a tetrahedron."""
    # The right half uses the mirrored tetrahedron, so that both halves are alike.
    mirror = np.ones_like(points)
    mirror[:, 0] = np.where(points[:, 0] < 0, -1.0, 1.0)
    values = np.stack([field(points + step * corner * mirror) for corner in _CORNERS], -1)
    slope = values @ _CORNERS * mirror
    return slope / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-9)
