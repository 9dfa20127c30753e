"""Lids and lips that close on any identity: the model's blink is that of its mean face.

Lips that an identity leaves apart at rest are brought together. Where lids of a person lie in the
eyeball they are pushed out of it, and a blink goes on until upper and lower lid meet. Metres, head
frame.
"""

from dataclasses import replace

import numpy as np

from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.capture.rig.features import LID_M, Features
from pica_core.capture.rig.guards import EyeSurface, outwards
from pica_core.capture.rig.mesh import RigMesh
from pica_core.types import Float64Array, FloatArray, Int64Array

OVERLAP_M = 0.0004
"""How far lids of a closed eye go past each other: their picture meets."""
ROOM_M, LINING_M = 0.0003, 0.004
"""Least distance of a lid from the eyeball at rest, which `LidGuard` keeps in every pose; and how
deep in it nothing is moved."""
LIP_REACH_M, LIP_DEEP_M, LIP_GAP_M = 0.006, 0.008, 0.006
"""How far from the line of contact skin goes along with a lip; how deep behind it lips may touch;
what opening is closed at most."""


def close_lids(mesh: RigMesh, features: Features) -> RigMesh:
    """A mesh whose lids lie on its eyeballs at rest and meet in a blink."""
    rest, motion = mesh.rest_m.copy(), mesh.motion_m.copy()
    skin = np.flatnonzero(mesh.of_part("skin"))
    for eye in mesh.eyes:
        offset = rest[skin] - eye.centre_m
        far = np.linalg.norm(offset, axis=1)
        near = skin[(far < 1.9 * eye.radius_m) & (offset[:, 2] > 0)]
        offset = rest[near] - eye.centre_m
        clear = EyeSurface(rest[eye.vertices] - eye.centre_m).clearance(offset)
        # What lies deep inside is the lid's own lining, which nobody sees.
        lack = np.where(clear > -LINING_M, np.maximum(ROOM_M - clear, 0.0), 0.0)
        rest[near] += outwards(offset, lack)
        blink = motion[ARKIT_INDEX["eyeBlinkLeft" if eye.side > 0 else "eyeBlinkRight"]]
        blink[near] *= _farther(rest, blink, near, features)[:, None]
    return replace(mesh, rest_m=rest, motion_m=motion)


def _farther(
    rest: Float64Array, blink: FloatArray, near: Int64Array, features: Features
) -> Float64Array:
    """How much farther each vertex goes in a blink for the lids to meet, as a factor. ``[n]``."""
    edge = features.eye_gap_m[near] < LID_M
    above = features.above_eye[near]
    upper, lower = near[edge & above], near[edge & ~above]
    if min(len(upper), len(lower)) < 4:
        return np.ones(len(near))
    low_closed = rest[lower] + blink[lower]
    order = np.argsort(low_closed[:, 0])
    closed = rest[upper] + blink[upper]
    line = np.interp(closed[:, 0], low_closed[order, 0], low_closed[order, 1])
    fall = np.maximum(-blink[upper, 1].astype(np.float64), 0.002)
    lack = np.clip((closed[:, 1] - line + OVERLAP_M) / fall, 0.0, 0.6)
    # A smooth function of the place across the eye; the corners stay.
    x = rest[near, 0]
    weight = np.exp(-0.5 * ((x[:, None] - rest[upper, 0]) / 0.0025) ** 2)
    weight *= np.minimum(fall / 0.004, 1.0) ** 2
    factor: Float64Array = (weight @ lack) / np.maximum(weight.sum(1), 1e-9)
    return 1.0 + np.where(above, factor, 0.0)


def close_lips(mesh: RigMesh, features: Features) -> RigMesh:
    """A mesh whose lips touch at rest: each lip goes half of the way."""
    mouth = features.mouth
    if mouth is None:
        return mesh
    rest = mesh.rest_m.copy()
    rise = rest[:, 1] - np.interp(rest[:, 0], mouth.x, mouth.y)
    behind = np.interp(rest[:, 0], mouth.x, mouth.z) - rest[:, 2]
    near = np.flatnonzero(
        (np.abs(rise) < 3 * LIP_REACH_M)
        & (np.abs(rest[:, 0] - mouth.centre_x) < mouth.half_m)
        & (np.abs(behind) < 0.025)
        & (mesh.of_part("skin") | replace(mesh, part=features.part).of_part("mouth_bag"))
    )
    edge = near[np.abs(behind[near]) < LIP_DEEP_M]
    places = np.linspace(-0.9, 0.9, 15) * mouth.half_m + mouth.centre_x
    lack = np.zeros(len(places))
    for k, x in enumerate(places):
        here = edge[np.abs(rest[edge, 0] - x) < 0.002]
        upper, lower = rise[here[rise[here] >= 0]], rise[here[rise[here] < 0]]
        if len(upper) and len(lower):
            lack[k] = max(upper.min() - lower.max() + OVERLAP_M, 0.0)
    lack = np.minimum(np.convolve(np.pad(lack, 1), [0.25, 0.5, 0.25], "valid"), LIP_GAP_M)
    gap = np.interp(rest[near, 0], places, lack)
    away = np.maximum(np.abs(rise[near]) - 0.5 * gap, 0.0) / LIP_REACH_M
    rest[near, 1] -= 0.5 * gap * np.sign(rise[near]) * np.exp(-(away**2))
    return replace(mesh, rest_m=rest)
