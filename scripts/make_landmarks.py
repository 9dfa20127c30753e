"""Find where on the face model the 478 landmarks lie: `pica_core/capture/me/landmarks.npz`.

    python scripts/make_landmarks.py         # some minutes of a core; needs `pica webcam setup`

People of the face model, with eyes open and lips closed, are drawn from several sides. The networks
find their landmarks in each picture, and the depth of the picture gives the place on the model's
surface. The medoid over all pictures is kept, with the spread around it; and, for photos, what the
networks are off by in the picture as a function of the view, and what is left: the same for all
views of a person, and not, from the front and from the side.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from scipy.spatial import KDTree

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.camera import Camera, look_at
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.me.face import LANDMARKS, TABLE
from pica_core.capture.me.photos import view_terms
from pica_core.capture.person.choices import draw_person, read_model
from pica_core.capture.person.subject import PersonSubject
from pica_core.face_networks import load_networks, region_of
from pica_core.types import Array, Float64Array, FloatArray, IntArray

VIEWS = [(a, e) for a in (-48, -32, -16, 0, 16, 32, 48) for e in (-14, 0, 14)]
PLACED = 32
"""Degrees up to which the outline of a picture is not yet that of the cheek."""
SIDE = 640
MIDDLE_M, DISTANCE_M = np.array([0, -0.02, 0.03]), (0.45, 0.9)
"""Of the face, and of cameras from it, as of phones."""
SURE, CANDIDATES = 0.9, 24


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--people", type=int, default=30)
    parser.add_argument("--networks", type=Path, default=None, help="face_landmarker.task")
    options = parser.parse_args()
    networks, mean = load_networks(options.networks), read_model().mean
    outer = np.isin(mean.part, [MATERIALS.index(name) for name in ("skin", "eye")])
    seen: list[tuple[int, Camera, FloatArray]] = []
    shapes: list[Float64Array] = []
    found = np.full((options.people, len(VIEWS), LANDMARKS, 3), np.nan)
    for seed in range(options.people):
        subject = PersonSubject(draw_person(1000 + seed), bake_size=1024, self_shadow=False)
        rest = subject.head.mesh.rest_m[: len(mean.rest_m)]
        shapes.append(rest.astype(np.float64))
        surface = trimesh.Trimesh(rest, mean.faces[outer], process=False)
        subject.pose(np.zeros(NUM_ARKIT))
        random = np.random.default_rng(seed)
        for number, view_deg in enumerate(VIEWS):
            azimuth, elevation = random.uniform(-5, 5, 2) + np.array(view_deg)
            camera = view_from(azimuth, elevation, random.uniform(*DISTANCE_M))
            view = subject.draw(camera)
            picture = Image.fromarray(view.image)
            for region in networks.detect(picture)[:1]:
                landmarks, sure = networks.landmarks(picture, region)
                for _ in range(2):  # as photos are read
                    landmarks, sure = networks.landmarks(picture, region_of(landmarks))
                if sure < SURE:
                    continue
                seen.append((seed, camera, landmarks))
                if abs(azimuth) > PLACED:
                    continue
                column, row = np.clip(landmarks[:, :2], 0, SIDE - 1).astype(int).T
                depth = view.depth_m[row, column]
                points = camera.lift(landmarks[:, :2], depth)
                corners, weights, apart = nearest(surface, points)
                place = np.einsum("nk,nkc->nc", weights, mean.rest_m[corners])
                place[(depth == 0) | (apart > 0.003)] = np.nan
                found[seed, number] = place
        subject.release()
        print(seed, "of", options.people, file=sys.stderr)
    centre, spread = medoid(found.reshape(-1, LANDMARKS, 3))
    surface = trimesh.Trimesh(mean.rest_m, mean.faces[outer], process=False)
    corners, weights, _ = nearest(surface, centre)
    places = [np.einsum("nk,nkc->nc", weights, shape[corners]) for shape in shapes]
    bias_m, noise_m = view_errors(seen, places)
    np.savez_compressed(
        TABLE, vertices=corners.astype(np.int32),
        weights=weights.astype(np.float32), spread_m=spread.astype(np.float32),
        view_bias_mm=np.float16(1000 * bias_m), noise_mm=np.float16(1000 * noise_m),
    )  # fmt: skip
    for name, some in (("all", slice(None)), ("best half", np.argsort(spread)[:239])):
        print(f"{name}: median spread {1000 * np.median(spread[some]):.2f} mm", file=sys.stderr)


def view_from(azimuth_deg: float, elevation_deg: float, away_m: float) -> Camera:
    """A camera that looks at the face from there, and shows as much of it from afar."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    level = np.cos(elevation)
    away = level * np.sin(azimuth), np.sin(elevation), level * np.cos(azimuth)
    return look_at(
        centre_m=MIDDLE_M + away_m * np.array(away),
        target_m=MIDDLE_M,
        vertical_fov=2 * np.arctan(0.19 / away_m),
        width=SIDE,
        height=SIDE,
    )


def view_errors(
    seen: list[tuple[int, Camera, FloatArray]], places: list[Float64Array]
) -> tuple[Float64Array, Float64Array]:
    """What landmarks are off by across the view, metres, as factors of `view_terms`, robustly
    ``[L, 2, 6]``; and deviations of what is left: shared by a person's views, and from the front
    and from the side beyond that ``[L, 3]``."""
    people = np.array([person for person, _, _ in seen])
    terms, off, turned = [], [], []
    for person, camera, landmarks in seen:
        at, away_m = camera.project(places[person])
        off.append((landmarks[:, :2] - at) * away_m[:, None] / camera.intrinsics[0, 0])
        x, y, z = camera.centre_m / np.linalg.norm(camera.centre_m)
        terms.append(view_terms(float(np.arctan2(x, z)), float(np.arcsin(y))))
        turned.append(abs(np.arctan2(x, z)) > 0.35)
    basis, apart, side = np.array(terms), np.array(off), np.array(turned)
    share, bias = np.ones(apart.shape[:2]), np.zeros((LANDMARKS, 2, basis.shape[1]))
    rest = apart
    for _ in range(4):
        for number in range(LANDMARKS):
            weighted = share[:, number, None] * basis
            system = weighted.T @ basis + 1e-3 * np.eye(basis.shape[1])
            bias[number] = np.linalg.solve(system, weighted.T @ apart[:, number]).T
        rest = apart - np.einsum("lck,nk->nlc", bias, basis)
        share = 1 / (1 + (np.linalg.norm(rest, axis=2) / 0.004) ** 2) ** 2
    mine = np.array([np.median(rest[people == person], axis=0) for person in people])
    deviation = [
        1.48 * np.median(np.abs(each), axis=(0, 2))
        for each in (mine, (rest - mine)[~side], (rest - mine)[side])
    ]
    return bias, np.stack(deviation, 1)


def nearest(surface: trimesh.Trimesh, points: Array) -> tuple[IntArray, Float64Array, Float64Array]:
    """Where on a surface points ``[N, 3]`` are nearest to, among the triangles whose middles are:
    three vertices, their weights, and the distance."""
    _, near = KDTree(surface.triangles_center).query(points, CANDIDATES)
    triangles = surface.triangles[near.ravel()]
    on = trimesh.triangles.closest_point(triangles, points.repeat(CANDIDATES, axis=0))
    weights = trimesh.triangles.points_to_barycentric(triangles, on)
    apart = np.linalg.norm(on.reshape(*near.shape, 3) - points[:, None], axis=2)
    best = np.arange(len(points)), apart.argmin(axis=1)
    return surface.faces[near[best]], weights.reshape(*near.shape, 3)[best], apart[best]


def medoid(places: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Geometric median of places ``[N, L, 3]``, and the median distance from it. ``[L, 3]``."""
    centre = np.nanmedian(places, axis=0)
    for _ in range(30):
        away = np.maximum(np.linalg.norm(places - centre, axis=2), 1e-5)
        weight = np.where(np.isnan(away), 0.0, 1 / away)[..., None]
        centre = (np.nan_to_num(places) * weight).sum(0) / np.maximum(weight.sum(0), 1e-9)
    return centre, np.nanmedian(np.linalg.norm(places - centre, axis=2), axis=0)


if __name__ == "__main__":
    main()
