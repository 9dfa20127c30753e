"""Neck, scalp and ears of a rig, from its shape: no material says where they are.

    neck    skin below a line in the profile: chin, angle of the jaw, nape; with the shoulders
    scalp   skin above a hairline
    ears    skin that stands off the sides of the head, and what lies in its folds

Distances are those of an average head; neck and ears are taken in the rig's own proportion, the
height from mouth to eyes. A rig without mouth or eyeballs has none of the two.
"""

import numpy as np

from pica_core.capture.triangles import components, nearest
from pica_core.types import BoolArray, Float64Array, IntArray

HAIRLINE = (
    (0.0, 0.100), (25.0, 0.102), (45.0, 0.092), (62.0, 0.072), (72.0, 0.030),
    (80.0, 0.004), (90.0, 0.034), (118.0, 0.036), (132.0, -0.012), (155.0, -0.045), (180.0, -0.052),
)  # fmt: skip
"""Height of the hairline, metres above the ears, over the azimuth from the front in degrees."""
EYE_TO_MOUTH_M = 0.070
"""Height from mouth to eyes of the head that the distances below were read off."""
JAW_LINE = ((-0.090, 0.010), (-0.010, -0.020), (0.045, -0.046), (0.090, -0.052))
"""Height of the jaw over the mouth, metres, over the place from back to front."""
EAR_FROM, EAR_TO = (-0.015, -0.055), (0.030, 0.015)
"""Box that an ear may lie in, metres: from under the mouth and behind the head's centre to over the
eyes and before the centre."""
EAR_STANDS_OFF_M = 0.004
"""How far skin must stand off the side of the head to be an ear's."""
EAR_REACH_M = 0.005
"""What lies so near to it in the profile is in the ear's folds."""
LEAST_EAR = (12, 0.008)
"""An ear has so many vertices that stand off, and stands off so far, metres."""


def hair_coverage(points: Float64Array) -> Float64Array:
    """How far above the hairline each point of a scalp lies: 0 at the line, 1 is 14 mm. ``[P]``."""
    azimuth = np.degrees(np.abs(np.arctan2(points[:, 0], points[:, 2] + 0.005)))
    line = np.interp(azimuth, *np.array(HAIRLINE).T)
    return np.clip((points[:, 1] - line) / 0.014, -1.0, 1.0)


def find_neck(points: Float64Array, skin: BoolArray, mouth_y: float, eye_y: float) -> BoolArray:
    """Skin below the jaw. ``[P]``."""
    scale = (eye_y - mouth_y) / EYE_TO_MOUTH_M
    place, height = scale * np.array(JAW_LINE).T
    below: BoolArray = points[:, 1] < mouth_y + np.interp(points[:, 2], place, height)
    return skin & below


def find_ears(
    points: Float64Array, faces: IntArray, skin: BoolArray, mouth_y: float, eye_y: float
) -> BoolArray:
    """Both ears. ``[P]``."""
    scale = (eye_y - mouth_y) / EYE_TO_MOUTH_M
    low = np.array([mouth_y + scale * EAR_FROM[0], scale * EAR_FROM[1]])
    high = np.array([eye_y + scale * EAR_TO[0], scale * EAR_TO[1]])
    margin = 0.03 * scale
    profile = points[:, 1:3]
    boxed = skin & ((profile > low) & (profile < high)).all(1)
    around = skin & ~boxed & ((profile > low - margin) & (profile < high + margin)).all(1)
    y, z = (profile - 0.5 * (low + high)).T
    terms = np.stack([np.ones_like(y), y, z, y * y, y * z, z * z], 1)
    ears = np.zeros(len(points), np.bool_)
    for side in (1.0, -1.0):
        across = side * points[:, 0]
        sideways = across > 0.04 * scale
        if np.count_nonzero(around & sideways) < LEAST_EAR[0]:
            continue
        # The side of the head without its ear: a paraboloid through what lies around.
        flat, *_ = np.linalg.lstsq(terms[around & sideways], across[around & sideways], rcond=None)
        off = np.where(boxed & sideways, across - terms @ flat, 0.0)
        high_enough = off > scale * EAR_STANDS_OFF_M
        label = components(faces[high_enough[faces].all(1)], len(points))
        ear = high_enough & (label == label[off.argmax()])
        if ear.sum() < LEAST_EAR[0] or off.max() < scale * LEAST_EAR[1]:
            continue
        near = np.flatnonzero(boxed & sideways)
        _, apart = nearest(profile[near], profile[ear])
        ears[near[apart < scale * EAR_REACH_M]] = True
    return ears
