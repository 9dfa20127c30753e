"""Relief that the smooth masses do not have: folds, grooves and pads, laid over the skin at rest.

Every stroke follows a line on the front of the face and pushes the skin in or out of the surface,
with a Gaussian profile across the line. Strokes are drawn for the subject's left and mirrored.
Millimetres.
"""

import itertools

import numpy as np

from pica_core.capture.procedural.surface import EYE_Y, HeadField
from pica_core.types import Float64Array


def _across(
    x: Float64Array, y: Float64Array, line: list[tuple[float, float]]
) -> tuple[Float64Array, Float64Array]:
    """Signed distance from a polyline (positive on its left) and the place along it, 0 to 1."""
    best = np.full(x.shape, np.inf)
    signed, along = np.zeros(x.shape), np.zeros(x.shape)
    pieces = len(line) - 1
    for index, ((x0, y0), (x1, y1)) in enumerate(itertools.pairwise(line)):
        dx, dy = x1 - x0, y1 - y0
        t = np.clip(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
        away = np.hypot(x - x0 - t * dx, y - y0 - t * dy)
        side = np.sign(dx * (y - y0) - dy * (x - x0))
        nearer = away < best
        best = np.where(nearer, away, best)
        signed = np.where(nearer, side * away, signed)
        along = np.where(nearer, (index + t) / pieces, along)
    return signed, along


def _stroke(
    x: Float64Array,
    y: Float64Array,
    line: list[tuple[float, float]],
    width: float,
    *,
    ends: float = 0.18,
    offset: float = 0.0,
) -> Float64Array:
    """A soft line of unit height; `offset` shifts it to the left of its direction."""
    away, along = _across(x, y, line)
    fade = np.clip(along / ends, 0.0, 1.0) * np.clip((1.0 - along) / ends, 0.0, 1.0)
    return np.exp(-0.5 * ((away - offset) / width) ** 2) * fade


def relief(field: HeadField, mouth_half: float, points: Float64Array) -> Float64Array:
    """How far each point of the skin ``[R, C, 3]`` moves outwards, mm. ``[R, C]``."""
    x, y, z = np.abs(points[..., 0]), points[..., 1], points[..., 2]
    front = np.clip((z - 30.0) / 30.0, 0.0, 1.0)
    face, age, mouth, nose = field.face, field.face.age, field.mouth_y, field.subnasale_y
    wing = 0.5 * face.nose_breadth
    eye = 0.5 * face.eye_distance
    h = np.zeros(x.shape)
    # Nasolabial fold: cheek above, groove below.
    fold = [(wing + 1.0, nose + 10.0), (wing + 6.0, nose - 1.0)]
    fold += [(mouth_half + 6.0, mouth + 9.0), (mouth_half + 8.5, mouth - 4.0)]
    depth = 0.35 + 1.2 * age
    h -= depth * _stroke(x, y, fold, 2.2, offset=-0.8)
    h += 1.1 * depth * _stroke(x, y, fold, 4.5, offset=5.5)
    # Alar groove: sets the nostril's wing off from the cheek.
    alar = [(wing - 4.5, nose + 15.0), (wing + 0.6, nose + 11.0), (wing + 1.4, nose + 4.0)]
    h -= 1.1 * _stroke(x, y, alar, 1.6, ends=0.3)
    # Philtrum: a groove between two ridges that end at the peaks of Cupid's bow.
    ridge = [(3.0, nose - 2.0), (4.6, mouth + face.upper_lip + 0.5)]
    h += 0.75 * _stroke(x, y, ridge, 1.4, ends=0.25)
    h -= 0.7 * _stroke(x, y, [(0.0, nose - 1.0), (0.0, mouth + face.upper_lip)], 2.0, ends=0.2)
    # Mentolabial fold above the pad of the chin.
    sulcus = mouth - face.lower_lip - 6.5
    h -= 2.0 * np.exp(-0.5 * ((x / 17.0) ** 2 + ((y - sulcus) / 3.6) ** 2))
    h += 1.3 * np.exp(-0.5 * ((x / 11.0) ** 2 + ((y - field.chin_y - 12.0) / 7.0) ** 2))
    # Corners of the mouth lie in a shallow pit with a small swelling outside it.
    corner = ((x - mouth_half - 1.5) / 3.2) ** 2 + ((y - mouth + 0.8) / 3.4) ** 2
    h -= (1.0 + 0.4 * age) * np.exp(-0.5 * corner)
    swelling = ((x - mouth_half - 8.0) / 3.6) ** 2 + ((y - mouth) / 6.0) ** 2
    h += 0.7 * np.exp(-0.5 * swelling)
    # Marionette line and jowl come with age.
    marionette = [(mouth_half + 2.0, mouth - 3.0), (mouth_half + 4.0, mouth - 22.0)]
    h -= 1.4 * max(age - 0.25, 0.0) * _stroke(x, y, marionette, 2.2, ends=0.3)
    jowl = ((x - mouth_half - 11.0) / 8.0) ** 2 + ((y - mouth + 24.0) / 8.0) ** 2
    h += 3.2 * max(age - 0.3, 0.0) * np.exp(-0.5 * jowl)
    # Tear trough and, with age, the bag above it.
    trough = [(eye - 15.0, 15.0), (eye - 9.0, 7.5), (eye + 3.0, 4.5), (eye + 14.0, 7.5)]
    h -= (0.15 + 0.8 * age) * _stroke(x, y, trough, 2.6, ends=0.3)
    bag = ((x - eye) / 11.0) ** 2 + ((y - EYE_Y + 12.0) / 3.0) ** 2
    h += 1.5 * max(age - 0.2, 0.0) * np.exp(-0.5 * bag)
    # The fold above the upper lid's crease, heavier outwards with age.
    hood = [(eye - 12.0, 30.5), (eye, 33.0), (eye + 14.0, 29.0)]
    h += (0.5 + 1.2 * age) * _stroke(x, y, hood, 3.0, ends=0.3)
    # Frown lines between the brows.
    frown = [(6.5, EYE_Y + face.brow_height + 5.0), (5.5, EYE_Y + face.brow_height - 6.0)]
    h -= 0.9 * age * _stroke(x, y, frown, 1.6, ends=0.4)
    return h * front
