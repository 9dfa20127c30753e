"""A drawn person as a scan, as photos and as a film."""

from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np
import trimesh
from PIL import Image

from helpers.small_capture import small_subject
from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.camera import aimed_camera, dome_cameras
from pica_core.types import ByteArray, Float64Array, IntArray

SIDE, AZIMUTHS = 640, (0.0, 25.0, -25.0)
MILLIMETRES, NOISE_M, HOLES = 1000.0, 0.0003, 6
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


def draw_person_from(*azimuths: float) -> list[ByteArray]:
    """Pictures of the small subject, over a grey ground."""
    subject = small_subject(bake_size=512)
    subject.pose(np.zeros(NUM_ARKIT))
    cameras = [aimed_camera("", each, 0.0, "head", width=SIDE, height=SIDE) for each in azimuths]
    drawn = [subject.draw(camera).image for camera in cameras]
    subject.release()
    return drawn


def write_photos(folder: Path) -> None:
    """Write a folder of photos."""
    folder.mkdir()
    for number, image in enumerate(draw_person_from(*AZIMUTHS)):
        Image.fromarray(image).save(folder / f"{number}.png")


def write_film(path: Path, images: list[ByteArray], seconds: float) -> None:
    """A film of still pictures, stored on its side, whose first time is not 0."""
    with av.open(str(path), "w") as film:
        stream = film.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = SIDE, SIDE, "yuv420p"
        stream.bit_rate = 8_000_000
        stream.set_display_rotation(90)
        for number in range(int(10 * seconds)):
            image = images[int(number / (10 * seconds) * len(images))]
            turned = np.ascontiguousarray(np.rot90(image, -1))
            frame = av.VideoFrame.from_ndarray(turned, format="rgb24")
            frame.pts, frame.time_base = 50 + number, Fraction(1, 10)
            film.mux(stream.encode(frame))
        film.mux(stream.encode())
