"""Cameras, identity and expressions of one person from places that are seen in several photos.

    pixel_ip = focal * project(R_i (mean_p + identity_p c + motion_p e_i + offset_p) + t_i)

with one identity c for all photos, one focal length a camera, and for each photo i a pose and an
expression e_i within [0, 1]. Each place p has an offset that all photos share, since what is seen
(a landmark of a network, a spot of skin) lies off the place of the model that stands for it by as
much in all of them; its prior says how far, and in which direction. So twelve photos of a landmark
that is 3 mm off are not taken for twelve measurements. Offsets are eliminated (Schur's complement),
and what is left is solved by Gauss and Newton's steps.

The priors: coefficients are N(0, 1) as those of people, expressions small, focal length as phones
have it, or as the photo's file says.
Source: bundle adjustment, Triggs et al. 1999; robust weight, Geman and McClure 1987.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.camera import Camera
from pica_core.capture.person.choices import NUM_MODES, FaceModel
from pica_core.types import Array, Float64Array

EXPRESSION, CALM = 0.03, 0.01
"""Mean of an expression's values, and below which all are alike (chosen: mostly calm)."""
ROBUST, MEDIAN = 3.0, 1.39
"""Residuals so many times their noise count a quarter; median of the squares of such noise."""
SIZE_KNOWN = 1e4
"""How surely a head has the size that is known, or the most usual one for its shape: certain."""
POSE = 6
_MINE = POSE + NUM_ARKIT


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Spots:
    """Places on the face model, each in a triangle of it.

    Attributes:
        mean_m: On the mean head, metres. ``[N, 3]``.
        identity_m: What each mode adds. ``[N, 3, 100]``.
        motion_m: What each shape adds. ``[N, 3, 52]``.
        offset_precision: How surely what is seen lies there, 1/m². ``[N, 3, 3]``.
    """

    mean_m: Float64Array
    identity_m: Float64Array
    motion_m: Float64Array
    offset_precision: Float64Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sight:
    """What one photo shows of places.

    Attributes:
        pixels: ``[N, 2]``.
        precision: Inverse covariance of each, 1/px²; 0 where a place is not seen. ``[N, 2, 2]``.
    """

    pixels: Float64Array
    precision: Float64Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Solution:
    """What was found.

    Attributes:
        coefficients: Of the identity modes. ``[100]``.
        expressions: Of each photo. ``[I, 52]``.
        cameras: Of each photo, in head axes.
        offset_m: Of each place. ``[N, 3]``.
        lens: Which focal length each photo has. ``[I]``.
        spread: Standard deviation of coefficients that is left, 1 where the photos say nothing.
            ``[100]``.
    """

    coefficients: Float64Array
    expressions: Float64Array
    cameras: tuple[Camera, ...]
    offset_m: Float64Array
    lens: Array
    spread: Float64Array = field(default_factory=lambda: np.ones(NUM_MODES))

    def points(self, spots: Spots, photo: int) -> Float64Array:
        """Where places of the model are in a photo, without their offsets. ``[N, 3]``."""
        moved = spots.motion_m @ self.expressions[photo]
        return np.asarray(spots.mean_m + spots.identity_m @ self.coefficients + moved)

    def shape(self, model: FaceModel, photo: int | None = None) -> Float64Array:
        """The model's vertices at rest, or as in a photo. ``[P, 3]``."""
        rest = model.mean.rest_m + np.tensordot(self.coefficients, model.modes_m, 1)
        if photo is None:
            return rest
        return rest + np.tensordot(self.expressions[photo], model.mean.motion_m, 1)


def solve(
    spots: Spots,
    sights: list[Sight],
    start: Solution,
    focal_prior: list[tuple[float, float]],
    *,
    size: tuple[Float64Array, float] | None = None,
    rounds: int = 12,
    is_rough: bool = False,
) -> Solution:
    """Find everything, from a rough start.

    Args:
        sights: One a photo.
        focal_prior: Focal length in pixels of each lens, and the spread of its logarithm.
        size: A unit vector in identity, and where along it coefficients lie, which says how large
            the head is; by default as `_usual_size` has it.
        is_rough: The start may be so far off that all residuals are many times their noise: none is
            let go that is no farther off than most.
    """
    found, lenses, count = start, len(focal_prior), len(sights)
    base = lenses + NUM_MODES
    total = base + _MINE * count
    along, place_along = size or (_usual_size(spots), 0.0)
    prior = np.ones(total)
    prior[:lenses] = [spread**-2 for _, spread in focal_prior]
    for k in range(count):
        prior[base + _MINE * k :][:POSE] = 1e-9
    for turn in range(rounds):
        system, right = np.diag(prior), np.zeros(total)
        for k, (focal, spread) in enumerate(focal_prior):
            now = found.cameras[int(np.flatnonzero(found.lens == k)[0])].intrinsics[0, 0]
            right[k] = np.log(focal / now) / spread**2
        right[lenses:base] = -found.coefficients
        system[lenses:base, lenses:base] += SIZE_KNOWN * np.outer(along, along)
        right[lenses:base] += SIZE_KNOWN * along * (place_along - along @ found.coefficients)
        off = np.einsum("ni,nij,nj->", found.offset_m, spots.offset_precision, found.offset_m)
        right[lenses:base] += off * _growth(spots, found.coefficients)
        inner = spots.offset_precision.copy()
        inner_right = -np.einsum("nij,nj->ni", inner, found.offset_m)
        cross = np.zeros((len(inner), 3, total))
        for k, sight in enumerate(sights):
            mine = np.r_[found.lens[k], lenses:base, base + _MINE * k : base + _MINE * (k + 1)]
            # Exponential: most values are 0, whatever the others are (reweighted each turn).
            calm = 1 / (EXPRESSION * np.maximum(found.expressions[k], CALM))
            values = np.arange(mine[-1] + 1 - NUM_ARKIT, mine[-1] + 1)
            system[values, values] += calm
            right[values] -= calm * found.expressions[k]
            rows, place, apart = _linear(spots, found, k, sight)
            far = np.einsum("ni,nij,nj->n", apart, sight.precision, apart)
            spread = float(np.median(far)) / MEDIAN if is_rough else 1.0
            near = ROBUST**2 * max(spread, 1.0)
            share = 1 / (1 + far / near) ** 2 if turn > 2 else 1 / (1 + far / 100)
            precision = sight.precision * share[:, None, None]
            weighted = np.einsum("nij,njc->nic", precision, rows)
            system[np.ix_(mine, mine)] += np.tensordot(rows, weighted, ((0, 1), (0, 1)))
            right[mine] += np.tensordot(weighted, apart, ((0, 1), (0, 1)))
            inner += np.einsum("nia,nij,njb->nab", place, precision, place)
            inner_right += np.einsum("nia,nij,nj->na", place, precision, apart)
            cross[..., mine] += np.einsum("nia,nic->nac", place, weighted)
        solved = np.linalg.solve(inner, np.concatenate([cross, inner_right[..., None]], 2))
        flat = cross.reshape(-1, total)
        system -= flat.T @ solved[..., :-1].reshape(-1, total)
        right -= flat.T @ solved[..., -1].ravel()
        step = np.asarray(np.linalg.solve(system, right), np.float64)
        offset = found.offset_m + solved[..., -1] - solved[..., :-1] @ step
        found = _moved(found, step, offset)
    inverse = np.linalg.inv(system)
    return replace(found, spread=np.sqrt(np.diag(inverse)[lenses:base]))


def _usual_size(spots: Spots) -> Float64Array:
    """The unit vector in identity along which the mean face only grows. ``[100]``.

    Photos do not tell a size, and all that differs from the mean face would be less in a smaller
    one, which is no reason to take it: of all sizes of a shape the most usual is the one whose
    coefficients are 0 along this.
    """
    grows = (spots.identity_m - spots.identity_m.mean(0)).reshape(-1, NUM_MODES)
    away = (spots.mean_m - spots.mean_m.mean(0)).ravel()
    known = grows.T @ grows / len(spots.mean_m) + 1e-9 * np.eye(NUM_MODES)
    along = np.linalg.solve(known, grows.T @ away)
    return np.asarray(along / np.linalg.norm(along))


def _growth(spots: Spots, coefficients: Float64Array) -> Float64Array:
    """How the logarithm of the size of all places grows with each coefficient. ``[100]``."""
    places = spots.mean_m + spots.identity_m @ coefficients
    away = places - places.mean(0)
    return np.einsum("ni,nic->c", away, spots.identity_m) / (away**2).sum()


def _linear(
    spots: Spots, found: Solution, photo: int, sight: Sight
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """How pixels follow from a photo's unknowns ``[N, 2, 1 + 100 + 58]`` and from places ``[N, 2,
    3]``, and how far they are from what is seen ``[N, 2]``."""
    camera = found.cameras[photo]
    points = found.points(spots, photo) + found.offset_m
    turned = points @ camera.rotation.T
    seen = turned + camera.translation_m
    focal = camera.intrinsics[0, 0]
    flat = seen[:, :2] / seen[:, 2:]
    to_pixel = np.zeros((len(seen), 2, 3))
    to_pixel[:, 0, 0] = to_pixel[:, 1, 1] = focal / seen[:, 2]
    to_pixel[:, :, 2] = -focal * flat / seen[:, 2:]
    place = to_pixel @ camera.rotation
    turns = np.stack([np.cross(axis, turned) for axis in np.eye(3)], 2)
    rows = np.concatenate(
        [
            focal * flat[..., None],
            place @ spots.identity_m,
            to_pixel @ turns,
            to_pixel,
            place @ spots.motion_m,
        ],
        2,
    )
    return rows, place, sight.pixels - (focal * flat + camera.intrinsics[:2, 2])


def _moved(found: Solution, step: Float64Array, offset: Float64Array) -> Solution:
    """A solution after a step."""
    lenses = int(found.lens.max()) + 1
    base = lenses + NUM_MODES
    cameras, expressions = [], []
    for k, camera in enumerate(found.cameras):
        mine = step[base + _MINE * k : base + _MINE * (k + 1)]
        intrinsics = camera.intrinsics.copy()
        intrinsics[[0, 1], [0, 1]] *= np.exp(np.clip(step[found.lens[k]], -0.3, 0.3))
        turn = Rotation.from_rotvec(mine[:3]).as_matrix()
        cameras.append(
            replace(
                camera,
                intrinsics=intrinsics,
                rotation=turn @ camera.rotation,
                translation_m=camera.translation_m + mine[3:POSE],
            )
        )
        expressions.append(np.clip(found.expressions[k] + mine[POSE:], 0, 1))
    return replace(
        found,
        coefficients=np.clip(found.coefficients + step[lenses:base], -3, 3),
        expressions=np.array(expressions),
        cameras=tuple(cameras),
        offset_m=offset,
    )
