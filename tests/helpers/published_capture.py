"""A small directory as Multiface publishes its captures."""

from pathlib import Path

import numpy as np
from PIL import Image

from pica_core.camera import dome_cameras
from pica_core.capture.dataset.multiface import krt_text

WIDTH, HEIGHT, TEXTURE = 24, 36, 16
SEGMENTS = ("E001_Neutral_Eyes_Open", "SEN-01-call_me", "SEN-02-later")
PLACES_MM = np.array([[0, 0, 80], [60, 0, 80], [0, 60, 80], [60, 60, 80]], np.float32)


def write_published(root: Path, frames: int = 4) -> Path:
    """A directory as Multiface publishes it, of a square with a UV seam along its diagonal."""
    cameras = dome_cameras(3, WIDTH, HEIGHT)
    root.mkdir()
    (root / "KRT").write_text(krt_text(cameras))
    lines = [f"{segment} {k:06d}" for segment in SEGMENTS for k in range(frames)]
    (root / "frame_list.txt").write_text("\n".join(lines) + "\n")
    (root / "audio").mkdir()
    (root / "audio" / "SEN-01-call_me.wav").write_bytes(b"no sound")
    for number, line in enumerate(lines):
        segment, name = line.split()
        mesh = root / "tracked_mesh" / segment
        mesh.mkdir(parents=True, exist_ok=True)
        places = PLACES_MM + number
        (mesh / f"{name}.bin").write_bytes(places.astype("<f4").tobytes())
        (mesh / f"{name}_transform.txt").write_text("1 0 0 10\n0 1 0 20\n0 0 1 30\n")
        world = places + np.array([10, 20, 30])
        (mesh / f"{name}.obj").write_text(
            "".join(f"v {x} {y} {z}\n" for x, y, z in world)
            + "vt 0.1 0.1\nvt 0.4 0.1\nvt 0.1 0.4\nvt 0.9 0.9\nvt 0.6 0.9\nvt 0.9 0.6\n"
            + "f 1/1 2/2 3/3\nf 4/4 3/5 2/6\n"
        )
        texture = np.zeros((TEXTURE, TEXTURE, 3), np.uint8)
        texture[-1] = 200  # the last row of the file is v = 0
        path = root / f"unwrapped_uv_{TEXTURE}" / segment / "average" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(texture).save(path)
        for place, camera in enumerate(cameras):
            path = root / "images" / segment / camera.name / f"{name}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.new("RGB", (WIDTH, HEIGHT), (number, place, 50)).save(path)
    return root
