"""What of a face no sum of shapes holds: skin that folds and slides, hair that swings, a tongue.

    folds    skin that loses more area than it can shrink buckles (Euler: by the root of what is too
             much): it rises between creases, which the stage shades, and sinks in them
    slides   between bone and neck skin stays behind the jaw, until friction takes it along
    swings   hanging hair is a damped pendulum of the head's motion; it bends, and the body stops it
    tongue   tip up and aside, as far as the mouth is open

Amounts are chosen to look like skin; nothing is measured on people.
"""

from functools import partial

import numpy as np
from scipy.sparse import csr_array

from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.rig.head import RigHead
from pica_core.capture.stage.paint import Growth, split_parts
from pica_core.capture.stage.tracker import Motion, head_to_world, smooth_signals
from pica_core.capture.triangles import areas, mean_of_neighbours
from pica_core.types import Array, Float64Array, FloatArray

LIVELY = Motion(reach=2.5, scale_s=0.4)
"""Of a head whose hair swings."""
SHRINKS, BUCKLED = 0.04, 0.22
"""Part of its area that skin loses before it folds, and at which folds are full."""
RINGS = 3
"""Of neighbours over which a loss of area spreads."""
RISE_M, CREASE_M = 0.0014, 0.0016
"""Height of full folds, and depth of their creases."""
SLACK_M, LIP_M = 0.006, (0.010, 0.030)
"""How far skin slides at most, and how near to the lips it begins to."""
LENGTH_M, DAMPING = 0.18, 0.16
"""Of the pendulum."""
HEAD_M, ROOM_M = np.array([0.065, np.inf, 0.110]), 0.002
"""Half axes of what stops hair, and how far hair goes towards it."""
UP_RAD, ASIDE_RAD, TONGUE_S = 0.5, 0.4, 0.15
"""Bend of the tongue in an open mouth, and how fast it changes."""
STEP_S, SETTLING_S = 1 / 120, 4.0
"""Steps of the pendulum, and how long before a take it starts."""
GRAVITY = np.array([0.0, -9.81, 0.0])
STILL = np.zeros(4)


def sway(seed: int, take: int, times_s: Float64Array) -> Float64Array:
    """What follows from inertia at moments of a take: angles of hair to the left and to the front,
    and of the tongue, upwards and to the left, radians. ``[T, 4]``."""
    clock = np.arange(-SETTLING_S, times_s.max() + 4 * STEP_S, STEP_S)
    poses = np.stack([head_to_world(seed, take, each, LIVELY) for each in clock])
    pull = GRAVITY - np.gradient(np.gradient(poses[:, :, 3], STEP_S, axis=0), STEP_S, axis=0)
    down = np.einsum("tij,ti->tj", poses[:, :, :3], pull)
    wanted = down[:, [0, 2]] / -down[:, 1:2]
    rate = np.sqrt(-GRAVITY[1] / LENGTH_M)
    angle, speed, found = wanted[0].copy(), np.zeros(2), []
    for goal in wanted:
        speed += STEP_S * (rate**2 * (goal - angle) - 2 * DAMPING * rate * speed)
        angle = angle + STEP_S * speed
        found.append(angle)
    hair = np.stack(found)[np.searchsorted(clock, times_s)]
    same = partial(np.random.default_rng, [seed, 0x70E6, take])
    tongue = np.tanh([smooth_signals(same(), 2, TONGUE_S, each) for each in times_s])
    return np.concatenate([hair, tongue], axis=1)


class Flesh:
    """What moves a posed head's vertices further.

    Args:
        growth: Hair that the mesh has, if it has some.

    Attributes:
        creases: How deep a crease each split vertex lies in when it folds, 0 to 1, ``[V]``.
    """

    def __init__(self, head: RigHead, growth: Growth | None) -> None:
        self._head = head
        source, mesh, features = head.chart.source, head.mesh, head.features
        self._rest = head.vertices(np.zeros(52))
        self.creases = np.zeros(len(source))
        self._faces = head.welded_faces
        self._around: csr_array = mean_of_neighbours(self._faces, len(source))
        self._area = self._vertex_areas(self._rest)
        skin = mesh.of_part("skin")[source]
        still = features.regions["lids"] | features.regions["lips"] | features.regions["ears"]
        self._folds = self._spread(skin & ~still[source])
        self._slides = np.zeros(len(source))
        jaw = np.linalg.norm(mesh.motion_m[ARKIT_INDEX["jawOpen"]][source], axis=1)
        if features.mouth is not None:
            mouth = features.mouth
            line = np.stack([mouth.x, mouth.y, mouth.z], 1)
            apart = np.linalg.norm(self._rest[:, None] - line, axis=2).min(1)
            near, far = LIP_M
            share = np.clip(jaw / max(float(jaw[skin].max()), 1e-9), 0, 1)
            free = np.clip((apart - near) / (far - near), 0, 1)
            self._slides = self._spread(skin * 4 * share * (1 - share) * free)
        part = split_parts(head)
        self._tongue = np.flatnonzero(part == MATERIALS.index("tongue"))
        self._hair = np.flatnonzero(part == MATERIALS.index("hair"))
        strand = np.zeros((0, 4)) if growth is None else growth.strand[source[self._hair]]
        self._hair = self._hair[: len(strand)]
        out = self._rest[self._hair] / HEAD_M**2
        self._out = out / np.linalg.norm(out, axis=1, keepdims=True)
        self._reach_m = (strand[:, 3] * strand[:, 0] ** 1.5)[:, None]

    def _spread(self, values: Array) -> Float64Array:
        for _ in range(RINGS):
            values = 0.5 * (values + self._around @ values)
        spread: Float64Array = values[self._head.welded]
        return spread

    def _vertex_areas(self, vertices: FloatArray) -> Float64Array:
        size = np.repeat(areas(vertices.astype(np.float64), self._faces), 3)
        return np.maximum(np.bincount(self._faces.ravel(), size, len(vertices)), 1e-12)

    def move(self, points: FloatArray, arkit: FloatArray, sway: Float64Array) -> FloatArray:
        """How far each split vertex is folded, 0 to 1; moves them, metres, in place. ``[V]``."""
        normals = self._head.normals(points)
        moved = points - self._rest
        along = moved - normals * (moved * normals).sum(1, keepdims=True)
        far = np.linalg.norm(along, axis=1) + 1e-9
        points -= along * (self._slides * SLACK_M * np.tanh(far / SLACK_M) / far)[:, None]
        lost = self._spread(1 - self._vertex_areas(points) / self._area)
        folded = self._folds * np.sqrt(np.clip((lost - SHRINKS) / (BUCKLED - SHRINKS), 0, 1))
        points += normals * (folded * (RISE_M - CREASE_M * self.creases))[:, None]
        self._swing(points, sway[:2])
        self._bend(points, arkit, sway[2:])
        return folded.astype(np.float32)

    def _swing(self, points: FloatArray, angles: Float64Array) -> None:
        here = points[self._hair]
        step = np.zeros_like(here)
        step[:, [0, 2]] = self._reach_m * np.sin(angles)
        step[:, 1:2] = self._reach_m * (1 - np.cos(np.hypot(*angles)))
        inwards = np.maximum(-(step * self._out).sum(1, keepdims=True), 0)
        stopped = inwards - ROOM_M * np.tanh(inwards / ROOM_M)
        points[self._hair] = here + step + self._out * stopped

    def _bend(self, points: FloatArray, arkit: FloatArray, bend: Float64Array) -> None:
        if not len(self._tongue):
            return
        depth = self._rest[self._tongue, 2]
        share = (depth - depth.min()) / max(float(np.ptp(depth)), 1e-9)
        here = points[self._tongue]
        root = here[share < 0.2].mean(0)
        opening = max(float(arkit[ARKIT_INDEX["jawOpen"]] - arkit[ARKIT_INDEX["mouthClose"]]), 0.0)
        room = min(2 * opening, 1.0)
        up, aside = UP_RAD * room * max(bend[0], 0.0) * share, ASIDE_RAD * room * bend[1] * share
        x, y, z = (here - root).T
        y, z = np.cos(up) * y + np.sin(up) * z, np.cos(up) * z - np.sin(up) * y
        x, z = np.cos(aside) * x + np.sin(aside) * z, np.cos(aside) * z - np.sin(aside) * x
        points[self._tongue] = root + np.stack([x, y, z], 1)
