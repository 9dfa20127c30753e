"""The head without its small parts, as a signed distance field, and rays that find its surface.

A head is a smooth union of a few anatomical masses (cranium, face, jaw, cheekbones, brow ridge,
nose, neck) minus eye sockets and temples. Grid lines of the skin chart become rays that start
inside the head; where a ray leaves the field, a vertex lies. Lips, lids and ears are added
afterwards (`skin`, `lids`, `parts`).

Everything here is in millimetres in the head frame (+x the subject's left, +y up, +z out of the
face).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pica_core.capture.identity import FaceShape

Float64Array = npt.NDArray[np.float64]

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


def _ellipsoid(
    p: Float64Array, centre: tuple[float, ...], radii: tuple[float, ...]
) -> Float64Array:
    q = p - np.asarray(centre)
    r = np.asarray(radii)
    k0 = np.linalg.norm(q / r, axis=-1)
    k1 = np.linalg.norm(q / (r * r), axis=-1)
    distance: Float64Array = k0 * (k0 - 1.0) / np.maximum(k1, 1e-9)
    return distance


def _cone(
    p: Float64Array, a: tuple[float, ...], b: tuple[float, ...], radius_a: float, radius_b: float
) -> Float64Array:
    """Distance to a capsule whose radius changes linearly from `a` to `b` (a little inexact)."""
    start, end = np.asarray(a), np.asarray(b)
    axis = end - start
    t = np.clip((p - start) @ axis / (axis @ axis), 0.0, 1.0)
    gap: Float64Array = np.linalg.norm(p - start - t[..., None] * axis, axis=-1)
    distance: Float64Array = gap - (radius_a + (radius_b - radius_a) * t)
    return distance


class HeadField:
    """The signed distance field of one identity's head; negative inside."""

    def __init__(self, face: FaceShape) -> None:
        self.face = face
        self.face_scale = face.face_height / 120.0
        self.eye_centre = (0.5 * face.eye_distance, EYE_Y, 76.5)
        self.subnasale_y = SELLION_Y - face.nose_length
        self.mouth_y = self.below(-43.5)
        self.chin_y = self.below(-90.0)

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
        below = self.below
        breadth, length = 0.5 * f.head_breadth, f.head_length
        cheek, jaw = 0.5 * f.cheekbone_breadth, 0.5 * f.jaw_breadth
        # Cranium: two ellipsoids, brow to vertex and the fuller, lower back of the head.
        d = _ellipsoid(p, (0, 54, 6), (breadth, 78, 0.5 * length - 2))
        d = smooth_min(d, _ellipsoid(p, (0, 36, -22), (breadth - 3, 76, 0.5 * length - 28)), 20)
        # Forehead: flatter than an ellipsoid and nearly upright.
        d = smooth_min(d, _ellipsoid(p, (0, 56, 44), (62, 46, 53.5)), 16)
        # Face block from the orbits to the chin.
        d = smooth_min(d, _ellipsoid(p, (0, below(-8), 36), (cheek - 10, 70, 58)), 18)
        # Maxilla and mandible around the teeth carry the lips.
        d = smooth_min(d, _ellipsoid(p, (0, below(-42), 66), (34, 34, 39.5)), 16)
        # Mandible: ramus, body and chin.
        gonion = (jaw - 11, below(-56), 14.0)
        chin_z = 84.0 + f.chin_projection
        chin = (0.30 * f.chin_breadth, self.chin_y + 13.5, chin_z)
        body = _cone(p, gonion, chin, 12.0, 13.5)
        body = smooth_min(body, _cone(p, (jaw - 3, -4.0, 2.0), gonion, 12, 12), 10)
        body = smooth_min(
            body, _ellipsoid(p, (0, self.chin_y + 14, chin_z + 3), (17, 13, 14.5)), 10
        )
        d = smooth_min(d, body, 20)
        # Cheeks: the soft part, then the zygomatic bone over it.
        d = smooth_min(
            d,
            _ellipsoid(p, (34, below(-24), 60), (24 * f.cheek_fullness, 30, 27 * f.cheek_fullness)),
            18,
        )
        d = smooth_min(d, _cone(p, (36, 1, 76), (cheek - 9, 5, 38), 12.5, 9), 16)
        d = smooth_min(d, _cone(p, (cheek - 9, 5, 38), (cheek - 9, 3, 4), 8.5, 8.5), 18)
        # Masseter: fills the side of the face between arch and jaw angle.
        d = smooth_min(d, _ellipsoid(p, (jaw - 9, below(-30), 24), (13.5, 34, 28)), 24)
        # Brow ridge and glabella.
        ridge = 1.2 * f.brow_ridge
        d = smooth_min(d, _cone(p, (9, 36, 89 + ridge), (44, 39, 74 + 0.6 * ridge), 9.5, 9.5), 10)
        # Orbits: the hollow the lids sit in; temples: shallow hollows behind the brow's end.
        x, y, _ = self.eye_centre
        socket = _ellipsoid(p, (x - 1.5, y - 0.5, 102), (19.0, 12.5, 17.0))
        d = smooth_max(d, -socket, 9)
        d = smooth_max(d, -_ellipsoid(p, (84, 34, 46), (17, 26, 22)), 22)
        # Neck with the sternomastoid mass behind the jaw, and the larynx.
        neck = 0.5 * f.neck_breadth
        column = _cone(p, (0, -40, -22), (0, -160, -14), neck - 3, neck - 1)
        column = smooth_min(column, _cone(p, (0, -100, 28), (0, -122, 25), 8, 10), 18)
        column = smooth_min(column, _cone(p, (neck - 9, -20, -16), (20, -155, 22), 9, 10), 16)
        return smooth_min(d, column, 18)

    def _nose(self, p: Float64Array, d: Float64Array, f: FaceShape) -> Float64Array:
        base_z = 98.5  # of the face around the subnasale
        tip_y = self.subnasale_y + 10.5 + f.nose_tip_lift
        tip_z = base_z + f.nose_protrusion - 9.0  # centre of a tip of 9 mm radius
        wing_x = 0.5 * f.nose_breadth - 6.6
        wing_y = self.subnasale_y + 6.5
        bridge_z = 86.5 + 3.5 * f.nose_bridge
        half = (0, 0.5 * (tip_y + SELLION_Y) + 1, 0.5 * (bridge_z + tip_z) - 1.5)
        bridge = _cone(p, (0, SELLION_Y + 2, bridge_z), half, 6.8, 7.4)
        bridge = smooth_min(bridge, _cone(p, half, (0, tip_y + 1, tip_z + 0.5), 7.2, 8.0), 6)
        d = smooth_min(d, bridge, 11)
        d = smooth_min(d, _ellipsoid(p, (0, tip_y, tip_z + 0.5), (9.0, 7.8, 9.2)), 6)
        d = smooth_min(d, _ellipsoid(p, (wing_x, wing_y, base_z + 3.5), (6.9, 6.8, 10.0)), 5.5)
        # Columella, then the nostrils cut out beside it.
        columella = _cone(
            p, (0, tip_y - 5, tip_z), (0, self.subnasale_y + 1.5, base_z + 2.5), 4.0, 4.4
        )
        d = smooth_min(d, columella, 5)
        nostril = _ellipsoid(
            p, (0.42 * wing_x + 1.6, self.subnasale_y + 2.0, base_z + 8.0), (3.4, 4.2, 5.6)
        )
        return smooth_max(d, -nostril, 3.0)


def cast(
    field: HeadField, origin: Float64Array, direction: Float64Array, reach: npt.ArrayLike = 150.0
) -> Float64Array:
    """Where rays out of the head leave it for the last time.

    Args:
        field: The head.
        origin: Points inside, mm. ``[N, 3]``.
        direction: Unit directions outwards. ``[N, 3]``.
        reach: Where the search starts, mm from the origin; short where the ray would meet another
            part. ``[N]``.

    Returns:
        Surface points, mm. float64 ``[N, 3]``.
    """
    distance = np.broadcast_to(np.asarray(reach, np.float64), len(origin)).copy()
    for _ in range(48):  # sphere tracing from outside; 0.85 because blends overestimate a little
        value = field(origin + distance[:, None] * direction)
        distance -= np.clip(0.85 * value, -4.0, 40.0)
        distance = np.maximum(distance, 1.0)
        if float(np.abs(value).max()) < 1e-3:
            break
    return origin + distance[:, None] * direction


def gradient(field: HeadField, points: Float64Array, step: float = 0.5) -> Float64Array:
    """Outward unit normals by central differences over `step` mm. float64 ``[N, 3]``."""
    axes = np.eye(3) * step
    slope = np.stack([field(points + axis) - field(points - axis) for axis in axes], -1)
    normals: Float64Array = slope / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-9)
    return normals
