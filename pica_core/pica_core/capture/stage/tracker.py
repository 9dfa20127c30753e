"""What a face tracker gets wrong, put on exact vertices: sub-millimetre, as good trackers are.

A smooth error over the face drifts with time: part of it stays for the whole capture (a template
that does not quite fit), the rest wanders over half a second. Errors along the surface are larger
than across it: images hold a surface better than they hold its sliding.

Amounts by region are in `SPREAD_MM`; they are chosen, not measured on a tracker. `capture.json`
states what came of them, and `docs/capture.md` shows it.
"""

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from pica_core.capture.dataset.files import Topology
from pica_core.capture.triangles import vertex_normals
from pica_core.types import Float64Array, FloatArray, Int64Array

WAVES = 3
"""Waves in a signal: one is a sine, many are near a Gaussian process."""
FIELD_WAVES = 48


def smooth_signals(
    random: np.random.Generator, count: int, scale_s: float, time_s: float
) -> Float64Array:
    """Signals of about unit variance, which change over `scale_s`, at a moment. ``[count]``."""
    frequency = random.normal(0.0, 1.0 / scale_s, (WAVES, count))
    phase = random.uniform(0.0, 2 * np.pi, (WAVES, count))
    return np.cos(frequency * time_s + phase).sum(axis=0) * np.sqrt(2.0 / WAVES)


def smooth_field(
    random: np.random.Generator, points_m: npt.NDArray[np.floating], scale_m: float
) -> Float64Array:
    """Weights at points ``[V, 3]`` of `FIELD_WAVES` strengths of unit variance, whose sum changes
    over `scale_m`. float64 ``[V, 48]``."""
    direction = random.normal(0.0, 1.0 / scale_m, (3, FIELD_WAVES))
    phase = random.uniform(0.0, 2 * np.pi, FIELD_WAVES)
    return np.sqrt(2.0 / FIELD_WAVES) * np.cos(points_m.astype(np.float64) @ direction + phase)


SPREAD_MM: dict[str, float] = {
    "hair": 0.32,
    "collar": 0.32,
    "neck": 0.24,
    "scalp": 0.24,
    "ears": 0.2,
    "face": 0.12,
    "eyeballs": 0.16,
    "lids": 0.18,
    "lips": 0.18,
}
"""Standard deviation of the smooth error along each axis, mm; the last region that applies counts,
elsewhere `ELSEWHERE_MM`."""
ELSEWHERE_MM = 0.2
FIELD_SCALE_M = 0.018
"""Distance over which the error changes."""
DRIFT_S = 0.5
"""Time over which it changes."""
LASTING_SHARE = 0.35
"""Share of the variance that stays through the capture."""
ACROSS = 0.5
"""How much of the error across the surface is left."""
LIMIT_MM = 0.98
"""No vertex is farther off than this."""


class SimulatedTracker:
    """A tracker's errors on one mesh, given at rest, metres ``[Vt, 3]``.

    Vertices with the same number in `places` ``[Vt]`` are one point, and stay together.
    """

    def __init__(
        self, topology: Topology, rest_m: FloatArray, seed: int, places: Int64Array
    ) -> None:
        random = np.random.default_rng([seed, 0x7AC4])
        self._seed = seed
        self._field = smooth_field(random, rest_m, FIELD_SCALE_M)
        self._lasting = random.normal(size=3 * FIELD_WAVES)
        self._faces = topology.faces
        _, first, number = np.unique(places, return_index=True, return_inverse=True)
        self._one_point = first[number.reshape(-1)]
        self._spread_m = 0.001 * topology.by_region(SPREAD_MM, ELSEWHERE_MM)[:, None]

    def follow(self, exact_m: FloatArray, take: int, time_s: float) -> FloatArray:
        """What the tracker says of its vertices, which are at `exact_m`: metres, ``[Vt, 3]``."""
        random = np.random.default_rng([self._seed, 0x7AC5, take])
        drift = smooth_signals(random, 3 * FIELD_WAVES, DRIFT_S, time_s)
        strengths = np.sqrt(LASTING_SHARE) * self._lasting + np.sqrt(1 - LASTING_SHARE) * drift
        error = self._field @ strengths.reshape(-1, 3) * self._spread_m
        normals = vertex_normals(exact_m, self._faces)
        error -= (1 - ACROSS) * (error * normals).sum(axis=1, keepdims=True) * normals
        limit = 0.001 * LIMIT_MM
        error *= limit / np.sqrt(limit**2 + (error**2).sum(axis=1, keepdims=True))
        return (exact_m + error[self._one_point]).astype(np.float32)


TURN_DEG = (2.5, 3.5, 1.5)
"""Standard deviations of nodding, turning and tilting, degrees (chosen: a seated speaker)."""
SHIFT_M = (0.006, 0.003, 0.006)
"""Standard deviations along x, y and z, metres (chosen)."""
SCALE_S = 0.9
"""Time over which the head moves."""
PIVOT_M = (0.0, -0.09, -0.015)
"""What the head turns about: the top of the neck, head frame."""
LIMIT = 2.0
"""Signals are held within so many standard deviations."""


def head_to_world(seed: int, take: int, time_s: float) -> Float64Array:
    """A head's pose in a take of a capture, by the capture's seed and the take's number.

    Returns:
        Rotation and translation (metres) from head frame to world. float64 ``[3, 4]``.
    """
    random = np.random.default_rng([seed, 0x4EAD, take])
    values = LIMIT * np.tanh(smooth_signals(random, 6, SCALE_S, time_s) / LIMIT)
    rotation = Rotation.from_rotvec(np.radians(TURN_DEG) * values[:3]).as_matrix()
    pivot = np.array(PIVOT_M)
    shift = pivot - rotation @ pivot + SHIFT_M * values[3:]
    return np.concatenate([rotation, shift[:, None]], axis=1)
