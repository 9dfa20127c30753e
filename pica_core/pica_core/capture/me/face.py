"""The face model at rest as a thing to be fitted: identity as a linear basis.

    vertices = mean + identity modes [100]      places on it = three vertices each

Where the 478 landmarks of the face networks lie on the model is stored beside this file. It was
measured (``scripts/make_landmarks.py``) on people of the model, drawn from several sides: a medoid
and its spread. Landmarks of the face's outline have a large spread, since the networks put them
where the outline of the *picture* is; those at eyes, nose and lips have half a millimetre.

Frames: everything of the model is in metres in our head frame (x to the subject's left, y up, z
forward, the middle between the eyeballs at ``EYES_AT_M``). A `Similarity` leads from there to the
frame of whatever the model is fitted to.

A fit is least squares, with the modes' own prior: coefficients of people are about N(0, 1).
Residuals are in metres, divided by ``noise_m``.
"""

import functools
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.person.choices import NUM_MODES, FaceModel, read_model
from pica_core.types import Array, Float64Array, IntArray

LANDMARKS = 478
TABLE = Path(str(files("pica_core.capture.me") / "landmarks.npz"))
SPREAD_FLOOR_M = 0.0008
"""Landmarks are never trusted more than this: a pixel of the networks' crop is that wide."""
ROUNDS, ALL_COUNT = 10, 4
"""Turns of a fit between pose and shape, and how many of them trust every place alike."""


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
    """Fixed places on the face model, as a linear function of identity.

    Attributes:
        mean_m: Places on the mean head. ``[N, 3]``.
        identity_m: What each mode adds. ``[100, N, 3]``.
        noise_m: How far a measurement of each is off, standard deviation. ``[N]``.
    """

    mean_m: Float64Array
    identity_m: Float64Array
    noise_m: Float64Array

    def at(self, coefficients: Float64Array) -> Float64Array:
        """Where they are for one person, head frame of the mean, metres. ``[N, 3]``."""
        return self.mean_m + np.tensordot(coefficients, self.identity_m, 1)


@functools.cache
def landmark_places() -> Places:
    """The 478 landmarks of the face networks on the full model."""
    model = read_model()
    with np.load(TABLE) as stored:
        vertices, weights = stored["vertices"], stored["weights"].astype(np.float64)
        spread_m = stored["spread_m"].astype(np.float64)

    def between(values: Array) -> Float64Array:
        corners = values[..., vertices, :].astype(np.float64)
        return np.einsum("nk,...nkc->...nc", weights, corners)

    return Places(
        mean_m=between(model.mean.rest_m),
        identity_m=between(model.modes_m),
        noise_m=np.maximum(spread_m, SPREAD_FLOOR_M),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Face:
    """A fitted face.

    Attributes:
        coefficients: Of the identity modes. ``[100]``.
        pose: From the head frame to the frame of what it was fitted to.
        residual_m: Distance of each place to what was measured. ``[N]``.
    """

    coefficients: Float64Array
    pose: Similarity
    residual_m: Float64Array


def fit_face(
    places: Places, measured: Float64Array, weights: Float64Array, *, scale: float | None = None
) -> Face:
    """Fit pose, size and identity to measured places.

    Args:
        measured: In any frame and unit. ``[N, 3]``.
        weights: How much each counts beside its noise, 0: not at all. ``[N]``.
        scale: Units per metre, where they are known; found if not.
    """
    coefficients = np.zeros(NUM_MODES)
    prior = np.full(NUM_MODES + 7, 1.0)
    prior[NUM_MODES:] = 1e-3
    if scale is not None:
        prior[-1] = 1e6
    robust, columns = weights.copy(), places.identity_m.reshape(NUM_MODES, -1).T
    for turn in range(ROUNDS):
        here = places.at(coefficients)
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
    here = places.at(coefficients)
    pose = align(here, measured, robust / places.noise_m**2, scale)
    residual = np.linalg.norm(pose.undo(measured) - here, axis=1)
    return Face(coefficients=coefficients, pose=pose, residual_m=residual)


def _small_moves(points: Float64Array) -> Float64Array:
    """How points move in small turns, shifts along the axes, and growth. ``[3 N, 7]``."""
    moves = [np.cross(axis, points) for axis in np.eye(3)]
    moves += [np.broadcast_to(axis, points.shape) for axis in np.eye(3)]
    return np.stack([*moves, points], -1).reshape(-1, 7)


def head_faces(model: FaceModel, *parts: str) -> IntArray:
    """Triangles of some parts of the model. ``[F, 3]``."""
    return model.mean.faces[np.isin(model.mean.part, [MATERIALS.index(name) for name in parts])]
