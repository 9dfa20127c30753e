"""The face model: ICT-FaceKit Light, a neutral face with expressions and 100 identity modes.

Two forms are read: the public repository (ICT-VGL/ICT-FaceKit), one OBJ file per shape and mode in
its folder ``FaceXModel``; or a folder with one .glb of neutral and expressions, the neutral OBJ and
``identity_modes.npz`` (`modes` int16 ``[K, V, 3]`` in the OBJ's order, times `scale_cm`).

Source: Li et al., "Learning Formation of Physically-Based Face Attributes", CVPR 2020. MIT licence,
    Copyright (c) 2020 USC Institute for Creative Technologies.
"""

import re
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pica_core.capture.dataset.obj import read_obj
from pica_core.capture.rig.gltf import read_glb
from pica_core.capture.rig.obj import read_obj_folder
from pica_core.capture.rig.source import RigSource
from pica_core.capture.triangles import nearest
from pica_core.errors import CaptureError
from pica_core.types import Float64Array, FloatArray

NUM_MODES = 100
NUM_VERTICES = 26_719
"""Vertices of the neutral face as published."""
FOLDER = "FaceXModel"
RIGHTS = "ICT-FaceKit Light, MIT licence, (c) 2020 USC Institute for Creative Technologies"
MODES_FILE = "identity_modes.npz"
NEUTRAL_FILE = "generic_neutral_mesh.obj"
NEEDED = ("jawOpen", "eyeBlink_L", "mouthSmile_L")
"""Shapes by which the model is known."""

MALE = (
    ((2.6, 4.4, 9.3), 1.3, (0.0, -0.15, 0.40)),
    ((5.8, -5.5, 3.0), 2.2, (0.55, -0.40, 0.0)),
    ((1.3, -8.8, 9.6), 1.8, (0.25, -0.50, 0.35)),
    ((0.0, -1.3, 12.0), 1.3, (0.0, -0.10, 0.30)),
    ((1.8, -1.8, 10.4), 0.9, (0.15, 0.0, 0.0)),
    ((0.6, -4.6, 11.0), 0.9, (0.0, 0.0, -0.15)),
    ((5.0, -12.5, 0.5), 3.5, (0.80, 0.0, 0.20)),
)
"""What sets a man's face off from the mean of both: place, reach and direction in cm of the head
frame, on the subject's left; mirrored on the right (chosen after Zhuang & Bradtmiller 2005:
brow, jaw, chin, nose and neck)."""
SEX_LENGTH = 2.2
"""How far along its direction a sex lies, in standard deviations of the modes (chosen)."""
HEAD_CM = (0.0, 1.43, 0.5)
"""The head frame's origin in the model's own coordinates, cm."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FaceModel:
    """A rig of the mean face, and what each identity mode adds to its vertices.

    Attributes:
        modes: In the source's units. float32 ``[100, V, 3]``.
    """

    source: RigSource
    modes: FloatArray

    def sex_direction(self) -> Float64Array:
        """Coefficients of a typical man's face; those of a woman's are its opposite. ``[100]``."""
        # In cm: the model's head is 34 cm high, whatever its file's unit.
        scale = 10.0 ** np.rint(np.log10(34.0 / np.ptp(self.source.positions[:, 1])))
        points = self.source.positions * scale - HEAD_CM
        wanted = np.zeros_like(points)
        for centre, reach, move in MALE:
            for side in (1.0, -1.0):
                apart = points - np.array(centre) * [side, 1, 1]
                weight = np.exp(-0.5 * (apart**2).sum(1) / reach**2)
                wanted += weight[:, None] * np.array(move) * [side, 1, 1]
        chosen = np.arange(0, len(points), 3)
        table = self.modes[:, chosen].reshape(NUM_MODES, -1).astype(np.float64) * scale
        target = wanted[chosen].ravel()
        ridge = 0.02 * np.trace(table @ table.T) / NUM_MODES * np.eye(NUM_MODES)
        found = np.linalg.solve(table @ table.T + ridge, table @ target)
        return SEX_LENGTH * found / np.linalg.norm(found)

    def person(self, coefficients: npt.ArrayLike) -> RigSource:
        """The rig of one identity ``[100]``; expressions stay those of the model."""
        offset = np.tensordot(np.asarray(coefficients, np.float32), self.modes, 1)
        return replace(self.source, positions=self.source.positions + offset, copyright=RIGHTS)


def read_model(folder: Path) -> FaceModel:
    """Read the face model from either form.

    Raises:
        CaptureError: Files are missing, or are those of another model or version.
    """
    if not folder.is_dir():
        raise CaptureError(f"{folder}: no such folder; clone ICT-VGL/ICT-FaceKit and name it")
    if (folder / FOLDER).is_dir():
        folder = folder / FOLDER
    compact = folder / MODES_FILE
    source, modes = _compact(folder, compact) if compact.is_file() else _published(folder)
    lacking = [name for name in NEEDED if name not in source.shapes]
    if lacking:
        raise CaptureError(f"{folder}: the shape {lacking[0]} is missing; not a whole face model")
    return FaceModel(source=source, modes=modes)


def _published(folder: Path) -> tuple[RigSource, FloatArray]:
    neutral = folder / NEUTRAL_FILE
    if not neutral.is_file():
        raise CaptureError(f"{neutral}: the file is missing; the folder {FOLDER} is needed")
    present = {path.stem for path in folder.glob("identity*.obj")}
    names = [f"identity{k:03d}" for k in range(NUM_MODES)]
    lacking = [name for name in names if name not in present]
    if lacking:
        raise CaptureError(
            f"{folder}: {lacking[0]}.obj is missing ({len(lacking)} of {NUM_MODES} modes are)"
        )
    source = read_obj_folder(folder)
    _check_vertices(neutral, len(source.positions))
    modes = np.stack([source.shapes[name] for name in names])
    shapes = {k: v for k, v in source.shapes.items() if not re.fullmatch(r"identity\d+", k)}
    return replace(source, shapes=shapes), modes


def _compact(folder: Path, path: Path) -> tuple[RigSource, FloatArray]:
    rigs = sorted(folder.glob("*.glb"))
    if len(rigs) != 1:
        raise CaptureError(f"{folder}: {len(rigs)} .glb files beside {MODES_FILE}; one is needed")
    neutral = read_obj(folder / NEUTRAL_FILE).positions()
    _check_vertices(folder / NEUTRAL_FILE, len(neutral))
    try:
        with np.load(path) as archive:
            packed, scale = archive["modes"], float(archive["scale_cm"])
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise CaptureError(f"{path}: modes and scale_cm cannot be read ({error})") from error
    if packed.shape != (NUM_MODES, NUM_VERTICES, 3) or not 0 < scale < 1:
        raise CaptureError(
            f"{path}: modes are {list(packed.shape)}; [{NUM_MODES}, {NUM_VERTICES}, 3] is needed"
        )
    source = read_glb(rigs[0])
    unit = 10.0 ** np.rint(np.log10(np.ptp(source.positions) / np.ptp(neutral)))
    points = source.positions / unit
    key = {tuple(row): k for k, row in reversed(list(enumerate(_grid(neutral))))}
    found = np.array([key.get(tuple(row), -1) for row in _grid(points)])
    off = np.flatnonzero(found < 0)  # between two places of the grid
    if len(off) < 0.1 * len(found):
        found[off], apart = nearest(points[off], neutral)
    if (found < 0).any() or apart.max(initial=0.0) > 0.001:
        raise CaptureError(f"{rigs[0]}: its vertices are not those of {NEUTRAL_FILE}")
    modes = packed[:, found].astype(np.float32) * np.float32(scale * unit)
    return source, modes


def _grid(points_cm: Float64Array) -> list[list[int]]:
    """Places in steps of 5 micrometres."""
    return np.rint(points_cm * 2000).astype(np.int64).tolist()


def _check_vertices(path: Path, count: int) -> None:
    if count != NUM_VERTICES:
        raise CaptureError(
            f"{path}: {count} vertices; the version that is known has {NUM_VERTICES}"
        )
