"""Directories as Ava-256 and NeRSemble v2 publish theirs, of a rendered capture."""

import io
import json
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

from pica_core.camera import Camera
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.dataset.files import CaptureFrame
from pica_core.capture.triangles import mean_of_neighbours
from pica_core.types import Array

TURN = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From our head frame to that of these meshes: upside down and looking along x."""
SHIFT_M = np.array([0.05, -0.02, 0.01])
FULL = 4096


def places(capture: Capture) -> tuple[Array, Array]:
    """A tracked vertex of each place, and the place of each tracked vertex."""
    rest_m = capture.vertices_m(capture.frames[0])
    found = np.unique(rest_m, axis=0, return_index=True, return_inverse=True)
    return found[1], found[2].reshape(-1)


def resampled_m(capture: Capture, frame: CaptureFrame) -> Array:
    """The tracked vertices as those of another mesh: none lies where one of the face model does,
    and all move as skin does. ``[Vt, 3]``"""
    faces, (first, place) = capture.tracked_topology.faces, places(capture)
    points_m = capture.vertices_m(frame)
    mixed = 0.7 * points_m + 0.3 * (mean_of_neighbours(faces, len(points_m)) @ points_m)
    return mixed[first][place]


def write_ava(capture: Capture, root: Path, copies: int = 1) -> Path:
    """A directory in the layout of Ava-256; every frame is there so many times.

    Its meshes are welded: a vertex of the OBJ has several texture coordinates along seams.
    """
    topology, (first, place) = capture.tracked_topology, places(capture)
    parts = root / "decoder"
    for folder in ("image", "segmentation_parts", "head_pose", "kinematic_tracking", "uv_image"):
        (parts / folder).mkdir(parents=True)
    faces, place = topology.faces + 1, place + 1
    (root / "face_topology.obj").write_text(
        "".join("v 0 0 0\n" for _ in first)
        + "".join(f"vt {u} {v}\n" for u, v in topology.vertex_uv)
        + "".join("f " + " ".join(f"{place[c - 1]}/{c}" for c in f) + "\n" for f in faces)
    )
    rows = [(name, frame) for name in range(copies) for frame in capture.frames]
    names = [f"{7 + 3 * k:06d}" for k in range(len(rows))]
    segments = {frame.segment for frame in capture.frames if frame.split == "test"}
    table = ["seg_id,frame_id"]
    for (_, frame), name in zip(rows, names, strict=True):
        segment = "EXP_free_face" if frame.segment in segments else frame.segment
        table.append(f"{'EXP_neutral_peak' if name == names[0] else segment},{int(name)}")
    (parts / "frame_list.csv").write_text("\n".join(table) + "\n")
    krt = []
    meshes, poses, textures = (
        zipfile.ZipFile(parts / f"{name}.zip", "w", kind)
        for name, kind in (
            ("kinematic_tracking/registration_vertices", zipfile.ZIP_DEFLATED),
            ("head_pose/head_pose", zipfile.ZIP_STORED),
            ("uv_image/color", zipfile.ZIP_STORED),
        )
    )
    with meshes, poses, textures:
        for (_, frame), name in zip(rows, names, strict=True):
            points = 1000 * (resampled_m(capture, frame)[first] @ TURN.T + SHIFT_M)
            head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
            head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
            meshes.writestr(f"{name}.ply", head.encode() + points.astype("<f4").tobytes())
            pose = capture.head_to_world(frame)
            turn = pose[:, :3] @ TURN.T
            moved = np.column_stack([turn, 1000 * (pose[:, 3] - turn @ SHIFT_M)])
            poses.writestr(f"{name}.txt", "\n".join(" ".join(map(str, row)) for row in moved))
            textures.writestr(f"color/{name}.avif", avif(capture.average_texture(frame)[::-1]))
    for number, camera in enumerate(capture.cameras):
        scale = FULL / camera.height
        shown = narrow(camera)
        matrix = np.eye(4)
        matrix[:3] = np.column_stack([camera.rotation, 1000 * camera.translation_m])
        intrinsics = camera.intrinsics.copy()
        intrinsics[0, 2] -= shown.start
        intrinsics[:2] *= scale
        ident = f"40{number:04d}"
        krt.append({"cameraId": ident, "K": intrinsics.T.tolist(), "distortion": [0, 0, 0, 0]})
        krt[-1]["T"] = matrix.T.tolist()
        with (
            zipfile.ZipFile(parts / "image" / f"cam{ident}.zip", "w") as images,
            zipfile.ZipFile(parts / "segmentation_parts" / f"cam{ident}.zip", "w") as masks,
        ):
            for (_, frame), name in zip(rows, names, strict=True):
                image = avif(capture.image(frame, camera.name)[:, shown])
                images.writestr(f"cam{ident}/{name}.avif", image)
                depth_m = capture.depth_m(frame, camera.name)[:, shown]
                part = np.where(depth_m > 0, 2, 0).astype(np.uint8)
                part[-4:] = 3  # the chair
                masks.writestr(f"{name}.png", encoded(part, "PNG"))
    (parts / "camera_calibration.json").write_text(json.dumps({"KRT": krt}))
    return root


def narrow(camera: Camera) -> slice:
    """The columns that images of this shape show."""
    width = round(camera.height * 2668 / FULL)
    left = (camera.width - width) // 2
    return slice(left, left + width)


def avif(image: Array) -> bytes:
    return encoded(image, "AVIF", quality=90, speed=10)


def encoded(image: Array, kind: str, **options: int) -> bytes:
    data = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(data, kind, **options)
    return data.getvalue()
