"""The files of an Ava-256 directory as it was published (Martinez et al. 2024).

    decoder/camera_calibration.json       {"KRT": [{"cameraId", "K", "distortion", "T"}]}: K and the
    world-to-camera T transposed, T in mm; K is for 2668 x 4096 pixels, whatever size is there
    decoder/frame_list.csv                seg_id,frame_id
    decoder/image/camID.zip               FRAME.avif
    decoder/segmentation_parts/camID.zip  FRAME.png: parts of the person, but for `NO_PERSON`
    decoder/head_pose/head_pose.zip       FRAME.txt: 3x4 head to world, mm
    decoder/kinematic_tracking/registration_vertices.zip    FRAME.ply: head frame, mm
    decoder/uv_image/color.zip            FRAME.avif: average texture, upside down
    face_topology.obj                     one for all people: there, or in the folder above

Audio, key points and the headset's cameras are left alone. Nothing of that data set is part of this
project; it has a licence of its own (CC BY-NC 4.0).
"""

import csv
import io
from pathlib import Path

import numpy as np

from pica_core.camera import Camera
from pica_core.capture.dataset import multiface
from pica_core.errors import CaptureError

CALIBRATION, FRAME_LIST = "decoder/camera_calibration.json", "decoder/frame_list.csv"
TOPOLOGY = "face_topology.obj"
PARTS = {
    "tracked_mesh": "decoder/kinematic_tracking/registration_vertices.zip",
    "pose": "decoder/head_pose/head_pose.zip",
    "texture": "decoder/uv_image/color.zip",
}
CAMERAS = {"images": "decoder/image", "mask": "decoder/segmentation_parts"}
NO_PERSON = (0, 3)
"""Parts in a segmentation that show no person: nothing, and the chair."""
HELD_OUT = "EXP_free_face"
FULL_COLUMNS, FULL_ROWS = 2668, 4096


def read_list(path: Path) -> list[tuple[int, list[str]]]:
    """Line, segment and frame of a list of frames."""
    rows = []
    for number, row in enumerate(csv.DictReader(io.StringIO(multiface.read_text(path))), start=2):
        frame = row.get("frame_id") or ""
        if not (frame.isdecimal() and len(frame) < 10):
            raise CaptureError(f"{path}:{number}: frame_id is {frame!r:.40}; a number is needed")
        rows.append((number, [row.get("seg_id") or "", f"{int(frame):06d}"]))
    return rows


def read_calibration(path: Path, width: int, height: int) -> tuple[Camera, ...]:
    """All calibrated cameras, for images of this size."""
    cameras: dict[str, Camera] = {}
    distorted = []
    for number, row in enumerate(multiface.read_json(path).get("KRT") or ()):
        where = f"{path}: KRT[{number}]"
        try:
            name = str(row["cameraId"])
            intrinsics = np.array(row["K"], np.float64).reshape(3, 3).T
            matrix = np.array(row["T"], np.float64).reshape(4, 4)[:, :3].T
            bent = np.abs(np.array(row.get("distortion", 0.0), np.float64)).max()
        except (KeyError, TypeError, ValueError) as error:
            raise CaptureError(f"{where}: cameraId, K and T are needed ({error})") from error
        if name in cameras:
            raise CaptureError(f"{where}: camera {name} is there twice")
        intrinsics[:2] *= height / FULL_ROWS
        cameras[name] = multiface.make_camera(where, name, intrinsics, matrix, width, height)
        distorted += [name] * bool(bent > multiface.STRAIGHT)
    multiface.tell_distorted(path, distorted)
    return tuple(cameras.values())
