"""Scans of people whose true shape is known: other units, turned, with holes and noise."""

from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.camera import dome_cameras
from pica_core.capture.me.face import align, head_faces
from pica_core.capture.person.choices import draw_person, read_model
from pica_core.capture.person.subject import PersonSubject
from pica_core.capture.triangles import nearest, samples
from pica_core.types import Float64Array

SPACING_M = 0.0003
UPSIDE_DOWN = np.diag([-1.0, -1.0, 1.0])


def write_scan(
    path: Path, seed: int, *, units: float = 1000.0, noise_m: float = 0.0003, holes: int = 6
) -> Float64Array:
    """Write a scan of a drawn person, upside down, in so many units a metre, as a GLB file; returns
    the true vertices of the model, metres ``[P, 3]``."""
    subject = PersonSubject(draw_person(seed, hair="short"), bake_size=512, self_shadow=False)
    points = subject.pose(np.zeros(NUM_ARKIT)).astype(np.float64)
    _, texture = subject.photograph(dome_cameras(5, 384, 384, "one"), 512)
    random = np.random.default_rng(seed)
    faces, chart = subject.topology.faces, subject.topology.vertex_uv
    middles, kept = points[faces].mean(1), np.ones(len(faces), np.bool_)
    for _ in range(holes):
        centre = middles[random.integers(len(middles))]
        kept &= np.linalg.norm(middles - centre, axis=1) > random.uniform(0.004, 0.015)
    same = subject.head.chart.source
    noise = random.normal(0, noise_m, (same.max() + 1, 3))[same]
    moved = units * (points + noise) @ UPSIDE_DOWN.T + random.normal(0, units, 3)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(texture))
    visual = trimesh.visual.TextureVisuals(uv=chart * [1, -1] + [0, 1], material=material)
    trimesh.Trimesh(moved, faces[kept], visual=visual, process=False).export(path)
    truth = subject.head.mesh.rest_m[: len(read_model().mean.rest_m)]
    subject.release()
    return truth


def face_error_m(rest_m: Float64Array, truth_m: Float64Array) -> float:
    """How far the skin of a face lies from a true one after rigid alignment, metres: the median
    distance to samples of its surface, which adds less than a third of `SPACING_M`."""
    model = read_model()
    skin = np.unique(head_faces(model, "skin"))
    moved = np.abs(model.mean.motion_m).max((0, 2)) > 0.001
    face = skin[moved[skin] & (truth_m[skin, 2] > 0.03) & (truth_m[skin, 1] < 0.06)]
    pose = align(rest_m[face], truth_m[face], np.ones(len(face)), 1.0)
    placed = pose.apply(rest_m[face])
    faces = head_faces(model, "skin")
    which, weights = samples(truth_m, faces, SPACING_M)
    _, apart = nearest(placed, np.einsum("nk,nkc->nc", weights, truth_m[faces[which]]))
    return float(np.median(apart))
