"""The face model as a thing to be fitted: identity and expression as two linear bases.

    vertices = mean + identity modes [100] + shapes [52]      places on it = three vertices each

Where the 478 landmarks of the face networks lie on the model is stored beside this file. It was
measured once (``scripts/make_landmarks.py``) on people of the model, drawn from several sides: a
medoid and its spread. Landmarks of the face's outline have a large spread, since the networks put
them where the outline of the *picture* is; those at eyes, nose and lips have half a millimetre.

Frames: everything of the model is in metres in our head frame (x to the subject's left, y up, z
forward, the middle between the eyeballs at ``EYES_AT_M``). A `Similarity` leads from there to the
frame of whatever the model is fitted to.

A fit is least squares, with the modes' own prior: coefficients of people are about N(0, 1), those
of shapes lie within 0 and 1. Residuals are in metres, divided by ``noise_m``.
"""

import functools
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.person.choices import NUM_MODES, FaceModel, read_model
from pica_core.types import Array, Float64Array, Int64Array, IntArray

LANDMARKS = 478
TABLE = Path(str(files("pica_core.capture.me") / "landmarks.npz"))
SPREAD_FLOOR_M = 0.0008
"""Landmarks are never trusted more than this: a pixel of the networks' crop is that wide."""
SHAPE_SIGMA = 0.3
"""Standard deviation of shapes in a face that is to be at rest (chosen)."""
ROUNDS, ALL_COUNT = 10, 4
"""Turns of a fit between pose and shape, and how many of them trust every place alike."""
NEAREST_FACES = 16
"""Triangles by the distance of their middles among which the nearest is looked for."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Similarity:
    """Takes head-frame points to another frame: ``scale * rotation @ p + translation``.

    Attributes:
        scale: Units of the other frame per metre.
        rotation: ``[3, 3]``, a proper rotation.
        translation: In the other frame's units. ``[3]``.
    """

    scale: float
    rotation: Float64Array
    translation: Float64Array

    def apply(self, points_m: Float64Array) -> Float64Array:
        """Head frame to the other one. ``[..., 3]``."""
        return self.scale * points_m @ self.rotation.T + self.translation

    def undo(self, points: Float64Array) -> Float64Array:
        """The other frame to the head frame, metres. ``[..., 3]``."""
        return (points - self.translation) @ self.rotation / self.scale


def align(
    points_m: Float64Array, others: Float64Array, weights: Float64Array, scale: float | None = None
) -> Similarity:
    """The similarity that brings points ``[N, 3]`` nearest to others, weighted (Umeyama 1991); of
    this scale, if it is given."""
    share = (weights / weights.sum())[:, None]
    one, two = (share * points_m).sum(0), (share * others).sum(0)
    a, b = points_m - one, others - two
    u, size, v = np.linalg.svd((share * b).T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    rotation = u * sign @ v
    if scale is None:
        scale = float((size * sign).sum() / (share * a * a).sum())
    return Similarity(scale=scale, rotation=rotation, translation=two - scale * rotation @ one)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Places:
    """Fixed places on the face model, as a linear function of identity and shapes.

    Attributes:
        mean_m: Places on the mean head. ``[N, 3]``.
        identity_m: What each mode adds. ``[100, N, 3]``.
        shapes_m: What each of the 52 shapes adds. ``[52, N, 3]``.
        noise_m: How far a measurement of each is off, standard deviation. ``[N]``.
    """

    mean_m: Float64Array
    identity_m: Float64Array
    shapes_m: Float64Array
    noise_m: Float64Array

    def at(self, coefficients: Float64Array, shapes: Float64Array) -> Float64Array:
        """Where they are for one face, head frame of the mean, metres. ``[N, 3]``."""
        moved = np.tensordot(coefficients, self.identity_m, 1)
        return self.mean_m + moved + np.tensordot(shapes, self.shapes_m, 1)

    def some(self, chosen: Int64Array) -> "Places":
        """Some of them."""
        return Places(
            mean_m=self.mean_m[chosen],
            identity_m=self.identity_m[:, chosen],
            shapes_m=self.shapes_m[:, chosen],
            noise_m=self.noise_m[chosen],
        )


def places_of(
    model: FaceModel, vertices: Int64Array, weights: Float64Array, noise_m: Float64Array
) -> Places:
    """Places that lie between vertices of a model: indices and weights ``[N, 3]``."""

    def between(values: Array) -> Float64Array:
        corners = values[..., vertices, :].astype(np.float64)
        found: Float64Array = np.einsum("nk,...nkc->...nc", weights, corners)
        return found

    return Places(
        mean_m=between(model.mean.rest_m),
        identity_m=between(model.modes_m),
        shapes_m=between(model.mean.motion_m),
        noise_m=noise_m,
    )


@functools.cache
def landmark_places() -> Places:
    """The 478 landmarks of the face networks on the full model."""
    with np.load(TABLE) as stored:
        noise = np.maximum(stored["spread_m"].astype(np.float64), SPREAD_FLOOR_M)
        return places_of(
            read_model(), stored["vertices"].astype(np.int64),
            stored["weights"].astype(np.float64), noise,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Face:
    """A fitted face.

    Attributes:
        coefficients: Of the identity modes. ``[100]``.
        shapes: What it does, 0 to 1. ``[52]``.
        pose: From the head frame to the frame of what it was fitted to.
        residual_m: Distance of each place to what was measured. ``[N]``.
    """

    coefficients: Float64Array
    shapes: Float64Array
    pose: Similarity
    residual_m: Float64Array


def fit_face(
    places: Places,
    measured: Float64Array,
    weights: Float64Array,
    *,
    with_shapes: bool = True,
    scale: float | None = None,
) -> Face:
    """Fit pose, size, identity and shapes to measured places.

    Args:
        measured: In any frame and unit. ``[N, 3]``.
        weights: How much each counts beside its noise, 0: not at all. ``[N]``.
        with_shapes: False holds the face at rest.
        scale: Units per metre, where they are known; found if not.
    """
    coefficients, shapes = np.zeros(NUM_MODES), np.zeros(NUM_ARKIT)
    count = NUM_MODES + NUM_ARKIT * with_shapes
    basis = places.identity_m
    if with_shapes:
        basis = np.concatenate([basis, places.shapes_m])
    prior = np.full(count + 7, 1.0)
    prior[NUM_MODES:count], prior[count:] = 1 / SHAPE_SIGMA, 1e-3
    if scale is not None:
        prior[-1] = 1e6
    robust, columns = weights.copy(), basis.reshape(count, -1).T
    for turn in range(ROUNDS):
        here = places.at(coefficients, shapes)
        pose = align(here, measured, robust / places.noise_m**2, scale)
        target = pose.undo(measured)
        if turn >= ALL_COUNT:  # from here on far places count less (Geman and McClure's weight)
            apart = np.linalg.norm(target - here, axis=1)
            robust = weights / (1 + (apart / (4 * places.noise_m)) ** 2) ** 2
        stiff = np.repeat(np.sqrt(robust) / places.noise_m, 3)
        # A little more turn, shift and size go along, so that neither waits for the other.
        rows = stiff[:, None] * np.concatenate([columns, -_small_moves(target)], 1)
        right = stiff * (target - places.mean_m).ravel()
        solved = np.linalg.solve(rows.T @ rows + np.diag(prior**2), rows.T @ right)
        coefficients = np.asarray(solved[:NUM_MODES], np.float64)
        if with_shapes:
            shapes[:] = np.clip(solved[NUM_MODES:count], 0.0, 1.0)
    here = places.at(coefficients, shapes)
    pose = align(here, measured, robust / places.noise_m**2, scale)
    residual = np.linalg.norm(pose.undo(measured) - here, axis=1)
    return Face(coefficients=coefficients, shapes=shapes, pose=pose, residual_m=residual)


def _small_moves(points: Float64Array) -> Float64Array:
    """How points move in small turns, shifts along the axes, and growth. ``[3 N, 7]``."""
    moves = [np.cross(axis, points) for axis in np.eye(3)]
    moves += [np.broadcast_to(axis, points.shape) for axis in np.eye(3)]
    return np.stack([*moves, points], -1).reshape(-1, 7)


class Surface:
    """Triangles among which the nearest point is looked up.

    Args:
        points: ``[V, 3]``.
        faces: ``[F, 3]``; kept as the attribute of this name.
    """

    def __init__(self, points: Float64Array, faces: IntArray) -> None:
        self.faces = faces
        self._corners = points[faces].astype(np.float64)
        self._tree = KDTree(self._corners.mean(1))

    def nearest(
        self, points: Float64Array, most: int = NEAREST_FACES
    ) -> tuple[Int64Array, Float64Array, Float64Array]:
        """The nearest place to each point: triangle ``[N]``, weights of its corners ``[N, 3]``, and
        how far it is ``[N]``."""
        _, near = self._tree.query(points, min(most, len(self.faces)))
        near = near.reshape(len(points), -1)
        corners = self._corners[near]
        weights = closest_weights(points[:, None], corners)
        apart = np.linalg.norm(
            np.einsum("nmk,nmkc->nmc", weights, corners) - points[:, None], axis=2
        )
        best = apart.argmin(1)
        row = np.arange(len(points))
        return near[row, best], weights[row, best], apart[row, best]


def closest_weights(points: Float64Array, corners: Float64Array) -> Float64Array:
    """Barycentric weights of the point of a triangle ``[..., 3, 3]`` that is nearest. ``[..., 3]``.

    Outside, the nearest point of the three sides is taken.
    """
    a, b, c = (corners[..., k, :] for k in range(3))
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = (ab * ab).sum(-1), (ab * ac).sum(-1), (ac * ac).sum(-1)
    d20, d21 = (ap * ab).sum(-1), (ap * ac).sum(-1)
    denominator = np.maximum(d00 * d11 - d01 * d01, 1e-30)
    v, w = (d11 * d20 - d01 * d21) / denominator, (d00 * d21 - d01 * d20) / denominator
    inside = np.stack([1 - v - w, v, w], -1)
    best, least = inside, np.where((inside >= 0).all(-1), 0.0, np.inf)
    for first, second in ((0, 1), (1, 2), (2, 0)):
        start, end = corners[..., first, :], corners[..., second, :]
        side = end - start
        t = ((points - start) * side).sum(-1) / np.maximum((side * side).sum(-1), 1e-30)
        t = np.clip(t, 0.0, 1.0)
        apart = ((start + t[..., None] * side - points) ** 2).sum(-1)
        weights = np.zeros_like(inside)
        weights[..., first], weights[..., second] = 1 - t, t
        nearer = apart < least
        best, least = np.where(nearer[..., None], weights, best), np.minimum(apart, least)
    return best


def head_faces(model: FaceModel, *parts: str) -> IntArray:
    """Triangles of some parts of the model. ``[F, 3]``."""
    return model.mean.faces[np.isin(model.mean.part, [MATERIALS.index(name) for name in parts])]
