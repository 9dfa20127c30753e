"""The face model that ships: a mean head, its 52 shapes, and 100 identity modes.

``face_model.npz`` is ICT-FaceKit Light, reduced and quantised by ``scripts/make_face_model.py``:
integers in the steps below, each but the first as its difference to the one before, split into
planes of bytes. The parts of its faces, its charts and seams, eyeballs, ears and neck are stored
with it; the islands of its charts are stretched so that each triangle has the room that it needs.

Source: Li et al., "Learning Formation of Physically-Based Face Attributes", CVPR 2020. MIT licence,
    Copyright (c) 2020 USC Institute for Creative Technologies.
"""

import functools
from dataclasses import dataclass, replace
from importlib.resources import files

import numpy as np
import numpy.typing as npt

from pica_core.capture.rig.mesh import (
    EYES_AT_M,
    MARKS,
    Eyeball,
    RigFrame,
    RigMesh,
    fit_sphere,
)
from pica_core.types import Array, ByteArray, Float64Array, FloatArray, Int64Array, IntArray

NUM_MODES = 100
RIGHTS = "ICT-FaceKit Light, MIT licence, (c) 2020 USC Institute for Creative Technologies"
REST_M, MODE_M, MOTION_M, UV_STEP = 1e-8, 2.5e-6, 2e-7, 2.0**-24
"""Steps in which places, modes, shapes and texture coordinates are stored: so fine that a person is
the same to the triangle as one made of the public files."""
EYES = ("eye_left", "eye_right")
COARSE = "coarse_"
"""Prefix of the triangles of the coarse mesh, over some of the same vertices."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FaceModel:
    """The mean head, and what each identity mode adds to its vertices.

    Attributes:
        mean: Metres, head frame.
        modes_m: float32 ``[100, P, 3]``.
        male: Coefficients of a typical man's face; those of a woman's are its opposite. ``[100]``.
    """

    mean: RigMesh
    modes_m: FloatArray
    male: Float64Array

    def mesh(self, coefficients: npt.ArrayLike) -> RigMesh:
        """The bare head of one identity ``[100]``; its shapes move it as they move the mean."""
        offset = np.tensordot(np.asarray(coefficients, np.float32), self.modes_m, 1)
        rest = self.mean.rest_m + offset
        spheres = [fit_sphere(rest[eye.vertices]) for eye in self.mean.eyes]
        move = EYES_AT_M - np.mean([centre for centre, _, _ in spheres], axis=0)
        eyes = [
            replace(eye, centre_m=centre + move, radius_m=radius)
            for eye, (centre, radius, _) in zip(self.mean.eyes, spheres, strict=True)
        ]
        return replace(self.mean, rest_m=rest + move, eyes=tuple(eyes))


def _sums(planes: ByteArray, axis: int = 0) -> Int64Array:
    """Integers from planes of bytes of their differences along an axis, coordinates apart."""
    folded = sum(plane.astype(np.int32) << (8 * place) for place, plane in enumerate(planes))
    changes = np.moveaxis((folded >> 1) ^ -(folded & 1), -2, -1)
    return np.cumsum(changes, axis=axis, dtype=np.int32)


@functools.lru_cache(maxsize=2)
def read_model(*, coarse: bool = False) -> FaceModel:
    """Read the face model, a fifth of a second; it does not change, so calls share it.

    Args:
        coarse: The mesh of 9,000 triangles, for trials that are to take seconds.
    """
    with np.load(str(files("pica_core.capture") / "face_model.npz")) as stored:
        table: dict[str, Array] = {name: stored[name] for name in stored.files}
    prefix = COARSE if coarse else ""
    part = table[prefix + "part"].astype(np.int32)
    used, faces = _compact(_sums(table[prefix + "faces"]))
    used_uv, uv_faces = _compact(_sums(table[prefix + "uv_faces"]))

    def marked(name: str) -> Int64Array:
        return np.flatnonzero(np.isin(used, table[name]))

    eyes = [
        Eyeball(
            side=side,
            centre_m=np.zeros(3),
            radius_m=0.0,
            vertices=marked(name),
            turned=False,
        )
        for side, name in zip((1.0, -1.0), EYES, strict=True)
    ]
    motion = _sums(table["motion"], 1)[:, used]
    mean = RigMesh(
        rest_m=REST_M * _sums(table["rest"])[used].astype(np.float64),
        motion_m=np.float32(MOTION_M) * motion.astype(np.float32),
        faces=faces,
        uv=UV_STEP * _sums(table["uv"])[used_uv].astype(np.float64),
        uv_faces=uv_faces,
        part=part,
        material=np.full(len(part), -1, np.int32),
        eyes=tuple(eyes),
        frame=RigFrame(unit="m", turned=False, guessed=()),
        dropped=(),
        marks={name: marked(name) for name in MARKS},
    )
    modes = np.float32(MODE_M) * _sums(table["modes"], 1)[:, used].astype(np.float32)
    return FaceModel(mean=mean, modes_m=modes, male=table["male"])


def _compact(faces: Int64Array) -> tuple[Int64Array, IntArray]:
    """The vertices that triangles use, and the triangles in these."""
    used, index = np.unique(faces, return_inverse=True)
    return used, index.reshape(-1, 3).astype(np.int32)
