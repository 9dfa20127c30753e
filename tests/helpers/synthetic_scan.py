"""A scan of a person whose true shape is known: other units, lying on its back, noise and holes."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from PIL import Image

from helpers.small_capture import small_subject
from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.camera import dome_cameras
from pica_core.capture.me.face import head_faces
from pica_core.capture.me.register import Registered
from pica_core.capture.person.choices import read_model
from pica_core.capture.triangles import nearest, samples
from pica_core.types import Float64Array, IntArray

MILLIMETRES, NOISE_M, HOLES, SPACING_M = 1000.0, 0.0003, 6, 0.0004
Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


class Truth(NamedTuple):
    """The surface that was scanned, in the frame of the scan: ``[V, 3]`` and ``[F, 3]``."""

    points: Float64Array
    faces: IntArray


def write_scan(path: Path) -> Truth:
    """Write a scan of a small subject as a GLB file in millimetres."""
    subject = small_subject(bake_size=512)
    points = subject.pose(np.zeros(NUM_ARKIT)).astype(np.float64)
    _, texture = subject.photograph(dome_cameras(5, 384, 384, "one"), 512)
    subject.release()
    random = np.random.default_rng(7)
    faces, chart = subject.topology.faces, subject.topology.vertex_uv
    middles, kept = points[faces].mean(1), np.ones(len(faces), np.bool_)
    for _ in range(HOLES):
        centre = middles[random.integers(len(middles))]
        kept &= np.linalg.norm(middles - centre, axis=1) > random.uniform(0.004, 0.015)
    same = subject.head.chart.source
    noise = random.normal(0, NOISE_M, (same.max() + 1, 3))[same]
    away = random.normal(0, MILLIMETRES, 3)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(texture))
    visual = trimesh.visual.TextureVisuals(uv=chart * [1, -1] + [0, 1], material=material)
    moved = MILLIMETRES * (points + noise) @ Z_UP.T + away
    trimesh.Trimesh(moved, faces[kept], visual=visual, process=False).export(path)
    return Truth(MILLIMETRES * points @ Z_UP.T + away, faces)


def face_error_m(found: Registered, rest_m: Float64Array, truth: Truth) -> float:
    """How far the skin of a face at rest ``[P, 3]`` lies from a true one where a head was found,
    metres: the median distance to samples of the surface."""
    model = read_model()
    moved = np.abs(model.mean.motion_m).max((0, 2)) > 0.001
    skin = np.unique(head_faces(model, "skin"))
    face = skin[moved[skin] & (rest_m[skin, 2] > 0.03) & (rest_m[skin, 1] < 0.06)]
    true_m = found.face.pose.undo(truth.points)
    near = (true_m[truth.faces].mean(1) - [0, -0.03, 0.07] < 0.1).all(1)
    faces = truth.faces[near & (true_m[truth.faces, 2].max(1) > 0.02)]
    which, weights = samples(true_m, faces, SPACING_M)
    _, apart = nearest(rest_m[face], np.einsum("nk,nkc->nc", weights, true_m[faces[which]]))
    return float(np.median(apart))
