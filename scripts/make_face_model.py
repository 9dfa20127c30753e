"""Make the face model that ships, of the public files of ICT-FaceKit Light.

    python scripts/make_face_model.py FOLDER pica_core/pica_core/capture/face_model.npz

FOLDER holds ``ict_head.glb`` (neutral and expressions), ``generic_neutral_mesh.obj`` and
``identity_modes.npz`` (`modes` int16 ``[K, V, 3]`` in the OBJ's vertex order, times `scale_cm`).
Layers over the eyes are left out. Places are stored in steps, as differences along the vertices;
the largest errors are printed. Charts, marks and the coarse mesh are kept from the file that stands
there: islands were stretched by a density-equalising flow, the coarse triangles chosen by quadrics,
and ears and neck marked on the mean head, by this repository as of commit 1f1d1a9d.

Source: Li et al., "Learning Formation of Physically-Based Face Attributes", CVPR 2020. MIT licence,
    Copyright (c) 2020 USC Institute for Creative Technologies.
"""

import argparse
import zipfile
from pathlib import Path

import numpy as np

from pica_core.capture.dataset.dataset import read_obj
from pica_core.capture.person.choices import (
    COARSE,
    EYES,
    MODE_M,
    MOTION_M,
    NUM_MODES,
    REST_M,
    read_model,
)
from pica_core.capture.rig.gltf import read_rig
from pica_core.capture.rig.mesh import MARKS, build_mesh
from pica_core.capture.rig.names import map_names
from pica_core.capture.triangles import nearest
from pica_core.types import Array, Float64Array, FloatArray

MALE = (
    ((2.6, 4.4, 9.3), 1.3, (0.0, -0.15, 0.40)),
    ((5.8, -5.5, 3.0), 2.2, (0.55, -0.40, 0.0)),
    ((1.3, -8.8, 9.6), 1.8, (0.25, -0.50, 0.35)),
    ((0.0, -1.3, 12.0), 1.3, (0.0, -0.10, 0.30)),
    ((1.8, -1.8, 10.4), 0.9, (0.15, 0.0, 0.0)),
    ((0.6, -4.6, 11.0), 0.9, (0.0, 0.0, -0.15)),
    ((5.0, -12.5, 0.5), 3.5, (0.80, 0.0, 0.20)),
)
"""What sets a man's face off from the mean of both: place, reach and direction in cm, on the
subject's left; mirrored on the right (chosen after Zhuang & Bradtmiller 2005: brow, jaw, chin, nose
and neck)."""
SEX_LENGTH = 2.2
"""How far along its direction a sex lies, in standard deviations of the modes (chosen)."""
KEPT = ("uv", "uv_faces", *MARKS, *(COARSE + name for name in ("faces", "uv_faces", "part")))
"""What is kept of the file that stands there."""
HEAD_CM = (0.0, 1.43, 0.5)
"""The origin of the places in `MALE`, in the model's own coordinates."""


def main() -> None:
    """Write the model, and print the largest error of each array."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    source = read_rig(options.folder / "ict_head.glb")
    modes_m, male = read_modes(options.folder, source.positions)
    mesh = build_mesh(source, map_names(list(source.shapes)))
    # Which of the file's vertices each one is: the tops of both are the same.
    places = mesh.frame.points(source.positions)
    place, top = places[places[:, 1].argmax()], mesh.rest_m[mesh.rest_m[:, 1].argmax()]
    kept, apart = nearest(mesh.rest_m, places + (top - place))
    assert apart.max() < 1e-9
    exact: dict[str, tuple[Array, float, int]] = {
        "rest": (mesh.rest_m, REST_M, 0),
        "modes": (mesh.frame.points(modes_m[:, kept]), MODE_M, 1),
        "motion": (mesh.motion_m, MOTION_M, 1),
        "faces": (mesh.faces, 1, 0),
    }
    table: dict[str, Array] = {name: planes(*values) for name, values in exact.items()}
    table |= {name: eye.vertices for name, eye in zip(EYES, mesh.eyes, strict=True)}
    with np.load(options.out) as before:
        table |= {name: before[name] for name in KEPT}
    with zipfile.ZipFile(options.out, "w", zipfile.ZIP_LZMA) as archive:
        for name, array in (table | {"part": mesh.part.astype(np.uint8), "male": male}).items():
            info = zipfile.ZipInfo(f"{name}.npy")
            info.compress_type = zipfile.ZIP_LZMA
            with archive.open(info, "w") as file:
                np.lib.format.write_array(file, np.ascontiguousarray(array))
    print(f"{options.out}: {options.out.stat().st_size / 1e6:.2f} MB")
    model = read_model()
    for name, array in (
        ("rest", model.mean.rest_m), ("modes", model.modes_m), ("motion", model.mean.motion_m),
    ):  # fmt: skip
        print(f"{name}: off by {1000 * np.abs(array - exact[name][0]).max():.6f} mm at most")


def planes(values: Array, step: float, axis: int) -> Array:
    """Differences of integers along an axis, signs folded in, as planes of bytes from the lowest;
    coordinates apart, so that what is alike stands together."""
    changes = np.diff(np.rint(values / step).astype(np.int64), axis=axis, prepend=0)
    folded = np.moveaxis(np.where(changes < 0, -2 * changes - 1, 2 * changes), -1, -2)
    count = (int(folded.max()).bit_length() + 7) // 8
    return np.stack([(folded >> (8 * place) & 255).astype(np.uint8) for place in range(count)])


def read_modes(folder: Path, points_m: Float64Array) -> tuple[FloatArray, Float64Array]:
    """Modes at the vertices of the .glb, metres ``[100, V, 3]``, and a man's coefficients."""
    with np.load(folder / "identity_modes.npz") as archive:
        packed, scale_cm = archive["modes"], float(archive["scale_cm"])
    neutral_cm = read_obj(folder / "generic_neutral_mesh.obj").points
    found, apart = nearest(100 * points_m, neutral_cm)
    assert apart.max() < 0.001
    modes_cm = packed[:, found].astype(np.float32) * np.float32(scale_cm)
    return modes_cm / 100, sex_direction(100 * points_m - HEAD_CM, modes_cm)


def sex_direction(points_cm: Float64Array, modes_cm: FloatArray) -> Float64Array:
    """Coefficients that come nearest to what `MALE` wants, `SEX_LENGTH` long. ``[100]``."""
    wanted = np.zeros_like(points_cm)
    for centre, reach, move in MALE:
        for side in (1.0, -1.0):
            apart = points_cm - np.array(centre) * [side, 1, 1]
            weight = np.exp(-0.5 * (apart**2).sum(1) / reach**2)
            wanted += weight[:, None] * np.array(move) * [side, 1, 1]
    chosen = np.arange(0, len(points_cm), 3)
    table = modes_cm[:, chosen].reshape(NUM_MODES, -1).astype(np.float64)
    ridge = 0.02 * np.trace(table @ table.T) / NUM_MODES * np.eye(NUM_MODES)
    found = np.linalg.solve(table @ table.T + ridge, table @ wanted[chosen].ravel())
    return SEX_LENGTH * found / np.linalg.norm(found)


if __name__ == "__main__":
    main()
