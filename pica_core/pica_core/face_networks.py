"""The three networks of MediaPipe's face landmarker, run by LiteRT on one thread.

What they take and give is their interface (model card "MediaPipe Face Mesh V2" and the graphs of
MediaPipe 0.10): a detector of faces in a picture of 128², a network of 478 landmarks in a turned
crop of 256², and one of 52 shapes from 146 of them. MediaPipe's own program is not used: it reports
on its users, and hides what it does to the values.
"""

import hashlib
import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import httpx
import numpy as np
from PIL import Image

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.errors import FaceNetworksError
from pica_core.files import FOLDERS, packaged_json, replacing
from pica_core.types import Float64Array, FloatArray

NUM_LANDMARKS: Final = 478
DETECTOR_SIZE: Final = 128
CROP_SIZE: Final = 256
MARGIN: Final = 1.5
"""The crop's side, as a multiple of the face's longer one."""
DETECTION_SCORE: Final = 0.5
SAME_FACE: Final = 0.3
"""Boxes whose overlap, as intersection over union, is above this are of one face."""
OUTER_CORNERS: Final = (33, 263)
"""Landmarks: outer corner of the right eye and of the left."""

TABLE: Final = packaged_json("pica_core", "face_networks.json")
"""``sha256``: of the networks' file; ``shape_landmarks``: what the third network is given, in this
order; ``shapes``: which shape of `ARKIT_NAMES` each of its answers is, -1 for the neutral face and
for what the networks cannot see: they say about 0 of cheekPuff, noseSneer, eyeWide and tongueOut,
whatever the face does, and so do we; ``head``: where landmarks are in a head, in units of
`pica_client.sources.webcam.UNIT_M`."""

_SUBSET = np.array(TABLE["shape_landmarks"])
_SHAPES = np.array(TABLE["shapes"])


@dataclass(frozen=True, slots=True)
class Region:
    """A square of the picture, turned about its middle.

    Attributes:
        x: Column of its middle, pixels.
        y: Row of its middle, pixels.
        side: Length of a side, pixels.
        angle: How far it is turned, radians, from the picture's x axis to its y axis.
    """

    x: float
    y: float
    side: float
    angle: float = 0.0

    def crop(self, picture: Image.Image, size: int) -> FloatArray:
        """What it shows, bilinear and black outside of the picture, within [0, 1]. float32
        ``[1, size, size, 3]``."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        step, half = self.side / size, self.side / 2
        across, down = step * cos, step * sin
        matrix = (
            *(across, -down, self.x - half * cos + half * sin),
            *(down, across, self.y - half * sin - half * cos),
        )
        kind, how = Image.Transform.AFFINE, Image.Resampling.BILINEAR
        cut = picture.transform((size, size), kind, matrix, resample=how)
        return np.asarray(cut, np.float32)[None] / np.float32(255)

    def to_picture(self, points: FloatArray) -> FloatArray:
        """Points of the region, with sides of 1, in pixels of the picture; depth alike. float32
        ``[N, 3]``."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        x, y = points[:, 0] - 0.5, points[:, 1] - 0.5
        placed = np.stack([x * cos - y * sin, x * sin + y * cos, points[:, 2]], 1) * self.side
        return np.asarray(placed + np.array([self.x, self.y, 0]), np.float32)


class FaceNetworks:
    """The networks, ready to run."""

    def __init__(self, detector: bytes, landmarks: bytes, shapes: bytes) -> None:
        """Load them.

        Raises:
            FaceNetworksError: LiteRT is not installed.
        """
        try:
            from ai_edge_litert.interpreter import Interpreter
        except ImportError as error:
            raise FaceNetworksError(
                "faces: install the extra me or webcam; LiteRT is missing"
            ) from error
        self._detector, self._landmarks, self._shapes = (
            _Network(Interpreter(model_content=each, num_threads=1))
            for each in (detector, landmarks, shapes)
        )
        self._anchors = _anchors()

    def detect(self, picture: Image.Image) -> list[Region]:
        """Find the faces of an RGB picture, the largest first."""
        width, height = picture.size
        whole = Region(width / 2, height / 2, max(width, height))
        offsets, logits = self._detector.run(whole.crop(picture, DETECTOR_SIZE) * 2 - 1)
        scores = _sigmoid(logits[0, :, 0])
        likely = np.flatnonzero(scores > DETECTION_SCORE)
        found = []
        # Middle, size and six points, two of them the eyes; all but the size from the anchor.
        anchors = np.tile(self._anchors[likely], 8)
        boxes = np.asarray(offsets[0, likely] / DETECTOR_SIZE + anchors, np.float64)
        boxes[:, 2:4] -= anchors[:, 2:4]
        for values in _merged(boxes, scores[likely]):
            points = whole.to_picture(np.c_[values.reshape(-1, 2), np.zeros(8)])
            middle, size, right_eye, left_eye = points[0], values[2:4] * whole.side, *points[2:4]
            dx, dy = (left_eye - right_eye)[:2]
            side = MARGIN * max(size)
            found.append(
                Region(float(middle[0]), float(middle[1]), float(side), float(np.arctan2(dy, dx)))
            )
        return sorted(found, key=lambda each: -each.side)

    def landmarks(self, picture: Image.Image, region: Region) -> tuple[FloatArray, float]:
        """Find the landmarks of a face: columns, rows and depths in pixels of the picture, float32
        ``[478, 3]``, and how sure it is that there is a face, 0 to 1."""
        points, presence, _ = self._landmarks.run(region.crop(picture, CROP_SIZE))
        sure = float(_sigmoid(presence.ravel()[:1])[0])
        return region.to_picture(points.reshape(NUM_LANDMARKS, 3) / np.float32(CROP_SIZE)), sure

    def shapes(self, landmarks: FloatArray) -> FloatArray:
        """Name the shapes of a face with these landmarks, float32 ``[478, 3]``: values in
        `ARKIT_NAMES` order, 0 for what the networks cannot see. float32 ``[52]``."""
        (values,) = self._shapes.run(landmarks[None, _SUBSET, :2])
        arkit = np.zeros(NUM_ARKIT, np.float32)
        arkit[_SHAPES[_SHAPES >= 0]] = np.clip(values.ravel()[_SHAPES >= 0], 0, 1)
        return arkit


def region_of(landmarks: FloatArray) -> Region:
    """Where to look for a face whose landmarks were there a moment ago."""
    low, high = landmarks[:, :2].min(0), landmarks[:, :2].max(0)
    right, left = landmarks[list(OUTER_CORNERS), :2]
    (x, y), (dx, dy) = (low + high) / 2, left - right
    side = MARGIN * float((high - low).max())
    return Region(float(x), float(y), side, float(np.arctan2(dy, dx)))


class _Network:
    """One network: arrays in, arrays out."""

    def __init__(self, interpreter: Any) -> None:
        interpreter.allocate_tensors()
        self._interpreter = interpreter
        self._input = interpreter.get_input_details()[0]["index"]
        self._outputs = [each["index"] for each in interpreter.get_output_details()]

    def run(self, values: FloatArray) -> list[FloatArray]:
        self._interpreter.set_tensor(self._input, np.ascontiguousarray(values, np.float32))
        self._interpreter.invoke()
        return [self._interpreter.get_tensor(index) for index in self._outputs]


def _sigmoid(logits: FloatArray) -> Float64Array:
    return np.asarray(1 / (1 + np.exp(-np.clip(logits, -80, 80))), np.float64)


def _anchors() -> Float64Array:
    """Middles of the detector's cells, 0 to 1: two on a grid of 16², then six on one of 8²."""
    found = []
    for cells, count in ((16, 2), (8, 6)):
        middles = (np.arange(cells) + 0.5) / cells
        grid = np.stack(np.meshgrid(middles, middles), -1).reshape(-1, 2)
        found.append(np.repeat(grid, count, 0))
    return np.concatenate(found)


def _merged(boxes: Float64Array, scores: Float64Array) -> list[Float64Array]:
    """One box a face: those that overlap, weighed by their scores (weighted suppression)."""
    found = []
    order = np.argsort(-scores)
    while len(order):
        low, high = boxes[:, :2] - boxes[:, 2:4] / 2, boxes[:, :2] + boxes[:, 2:4] / 2
        first = order[0]
        shared = np.minimum(high[order], high[first]) - np.maximum(low[order], low[first])
        common = np.prod(np.clip(shared, 0, None), 1)
        area = np.prod(boxes[:, 2:4], 1)
        same = common / (area[order] + area[first] - common + 1e-9) > SAME_FACE
        same[0] = True
        alike = order[same]
        found.append(np.average(boxes[alike], axis=0, weights=scores[alike]))
        order = order[~same]
    return found


SHA256: Final[str] = TABLE["sha256"]
URL: Final = (
    "https://storage.googleapis.com/mediapipe-models/face_landmarker/face_landmarker/float16/1/"
    "face_landmarker.task"
)
"""Where its authors publish it."""
TIMEOUT_S: Final = 30.0
_MEMBERS: Final = (
    "face_detector.tflite",
    "face_landmarks_detector.tflite",
    "face_blendshapes.tflite",
)


def model_path() -> Path:
    """Where the file lies on this machine, or would."""
    return FOLDERS.user_data_path / "models" / "face_landmarker.task"


def install(source: str = URL) -> Path:
    """Fetch the file, check it, and put it where it belongs.

    Args:
        source: An address or a path of the file.

    Returns:
        Where it is.

    Raises:
        FaceNetworksError: It cannot be read, or is not that file.
    """
    data = _checked(_fetch(source) if "://" in source else _read(Path(source)), source)
    path = model_path()
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        part.write_bytes(data)
    return path


def load_networks(path: Path | None = None) -> FaceNetworks:
    """Load the networks from their file.

    Raises:
        FaceNetworksError: The file or a package is not there, or not the right one; names what to
            do.
    """
    path = path or model_path()
    if not path.exists():
        raise FaceNetworksError("the face networks are not there yet; run: pica webcam setup")
    with zipfile.ZipFile(io.BytesIO(_checked(_read(path), str(path)))) as archive:
        return FaceNetworks(*(archive.read(name) for name in _MEMBERS))


def _fetch(url: str) -> bytes:
    try:
        answer = httpx.get(url, timeout=TIMEOUT_S, follow_redirects=True)
        return answer.raise_for_status().content
    except httpx.HTTPError as error:
        raise FaceNetworksError(
            f"{url}: {error}; fetch the file by another way, then: pica webcam setup --from FILE"
        ) from error


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise FaceNetworksError(f"{path}: {error.strerror}") from error


def _checked(data: bytes, source: str) -> bytes:
    found = hashlib.sha256(data).hexdigest()
    if found != SHA256:
        raise FaceNetworksError(
            f"{source} is not the face landmarker: its SHA-256 is {found[:12]}…, "
            f"{SHA256[:12]}… is needed"
        )
    return data
