"""A webcam as a tracker. Its pictures stay in this process: what leaves it is the latent."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import ExifTags, Image, ImageDraw

from pica_client.errors import SourceError
from pica_client.sources.calibration import Calibration
from pica_client.sources.live_face import TrackerSample, rotation_vector_from_quaternion
from pica_client.sources.tracker import SampleTap, Tracker
from pica_core.face_networks import TABLE, FaceNetworks, Region, region_of
from pica_core.types import Float64Array, FloatArray
from pica_core.types import Image as Picture

_INDICES = np.array([*map(int, TABLE["head"])])
_HEAD = np.array([*TABLE["head"].values()])
_HEAD -= _HEAD.mean(0)
DEPTH_FACTOR: Final = 0.8
UNIT_M: Final = 0.06
"""Length of 1 in the table: the outer corners of adults' eyes are 90 mm apart."""
FOCAL_LENGTH: Final = 0.9
"""How long a usual webcam's is, in widths of its picture (chosen: it sees 58 degrees)."""


def head_pose(landmarks: FloatArray, width: int, height: int) -> tuple[FloatArray, FloatArray]:
    """Find the pose of a head.

    Args:
        landmarks: Columns, rows and depths in pixels, the picture not mirrored. float32 ``[478,
            3]``.
        width: Of the picture, pixels.
        height: Of the picture, pixels.

    Returns:
        Its rotation vector in radians, and its place before the camera in metres, both in the axes
        of a head that looks at the camera: +x the subject's left, +y up, +z towards the camera.
        float32 ``[3]`` each. The place supposes an adult's head and a usual camera.
    """
    points = landmarks[_INDICES] * [1.0, -1.0, -DEPTH_FACTOR]
    middle = points.mean(0)
    points = points - middle
    u, _, v = np.linalg.svd(_HEAD.T @ points)
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    rotation = v.T @ mirror @ u.T
    unit_px = float(np.sqrt((points**2).sum() / (_HEAD**2).sum()))
    focal_px = FOCAL_LENGTH * width
    distance_m = focal_px * UNIT_M / max(unit_px, 1e-6)
    x, y = (middle[:2] - [width / 2, -height / 2]) * distance_m / focal_px
    return _rotation_vector(rotation), np.array([x, y, -distance_m], np.float32)


def _rotation_vector(matrix: Float64Array) -> FloatArray:
    """Axis times angle of a rotation by less than half a turn."""
    real = np.sqrt(max(1 + np.trace(matrix), 1e-12)) / 2
    axis = matrix[[2, 0, 1], [1, 2, 0]] - matrix[[1, 2, 0], [2, 0, 1]]
    return rotation_vector_from_quaternion((real, *(axis / (4 * real))))


FORMATS: Final = {"linux": "v4l2", "darwin": "avfoundation", "win32": "dshow"}
DEVICE_OPTIONS: Final = {"video_size": "640x480", "framerate": "30"}
"""What nearly every camera can do; others are opened without options."""
MAX_PIXELS: Final = 4096 * 2304
"""A larger picture is not decoded."""
USUAL_STEP_S, LONGEST_STEP_S = 1 / 30, 10.0
"""From a film's picture to its next, where the film does not say; and where its clock jumps, as in
streams that were joined, at most."""


def device_of(text: str) -> tuple[str, str | None]:
    """What PyAV is to open: a file, or a device and the kind of device. The user wrote nothing, a
    camera's number or name, or a file."""
    path = Path(text).expanduser()
    if text and path.is_file():
        return str(path), None
    kind = FORMATS.get(sys.platform, "v4l2")
    if kind == "v4l2":
        return (f"/dev/video{text or 0}" if not text or text.isdecimal() else text), kind
    if kind == "dshow":
        return f"video={text or 'Integrated Camera'}", kind
    return text or "0", kind


def open_camera(text: str) -> Any:
    """Open a camera or a video.

    Raises:
        SourceError: It is not there, is busy, or is none.
    """
    try:
        import av
    except ImportError as error:
        raise SourceError("webcam: install the extra webcam; PyAV is missing") from error
    name, kind = device_of(text)
    if kind == "v4l2" and not Path(name).exists():
        raise SourceError(f"webcam: there is neither a camera nor a file {name}")
    limit = {"max_pixels": str(MAX_PIXELS)}
    tries: list[dict[str, str]] = [limit] if kind is None else [DEVICE_OPTIONS, {}]
    for options in tries:
        try:
            container = av.open(name, format=kind, options=options)
        except (av.FFmpegError, OSError, ValueError, LookupError) as error:
            reason = error
            continue
        if container.streams.video:
            if (codec := container.streams.video[0].codec_context) is not None:
                codec.options = limit
            return container
        container.close()
        raise SourceError(f"webcam: {name} has no pictures")
    busy = "; does another program use it?" if kind else ""
    raise SourceError(f"webcam: {name}: {getattr(reason, 'strerror', None) or reason}{busy}")


def pictures(
    container: Any, is_video: bool, wait: Callable[[float], bool]
) -> Iterator[tuple[Image.Image, float | None]]:
    """Give its pictures as they come, until the camera is gone. A video is shown at its own speed,
    again and again.

    Args:
        container: From `open_camera`.
        is_video: Whether it is a video.
        wait: Waits some seconds; returns whether to stop.

    Yields:
        A picture, and when it was taken, seconds by the camera's clock, if that is known.
    """
    import av

    began_s, shown_s = time.monotonic(), -USUAL_STEP_S
    while True:
        is_empty, before_s = True, None  # films cut from longer ones, and streams, begin anywhere
        # Damaged from here on, or the camera was pulled; PyAV finds no stream that is new.
        with suppress(av.FFmpegError, LookupError):
            for frame in container.decode(video=0):
                picture, taken_s = _upright(frame, container.name), frame.time
                is_empty = False
                if is_video:
                    known = taken_s is not None and before_s is not None
                    step_s = taken_s - before_s if known else USUAL_STEP_S
                    shown_s += step_s if 0 <= step_s <= LONGEST_STEP_S else USUAL_STEP_S
                    before_s, taken_s = taken_s, shown_s
                if wait(max(began_s + shown_s - time.monotonic(), 0.0) if is_video else 0.0):
                    return
                yield picture, taken_s
        if not is_video or is_empty:
            return
        with suppress(av.FFmpegError):  # a stream that cannot be rewound gives nothing more
            container.seek(0)


def _upright(frame: Any, path: str) -> Image.Image:
    """The picture of a frame; phones store theirs on their side, and mirrored."""
    picture: Image.Image = frame.to_image(threads=1)
    degrees: int = frame.rotation
    if _is_mirrored(frame, path):
        picture, degrees = picture.transpose(Image.Transpose.FLIP_LEFT_RIGHT), degrees + 180
    return picture.rotate(degrees, expand=True) if degrees % 360 else picture


def _is_mirrored(frame: Any, path: str) -> bool:
    from av.sidedata.sidedata import Type

    try:
        matrix = frame.side_data.get(Type.DISPLAYMATRIX)
    except ValueError:  # side data of a kind that PyAV does not know: a photo's EXIF
        with suppress(OSError), Image.open(path, formats=("JPEG",)) as photo:
            return photo.getexif().get(ExifTags.Base.Orientation) in (2, 4, 5, 7)
        return False
    if matrix is None:
        return False
    a, b, _, c, d = np.frombuffer(matrix, np.int32)[:5].astype(np.float64)
    return bool(a * d < b * c)


PRESENT = 0.5
"""Below this the landmarks' network does not believe that there is a face."""
MAX_SIDE = 4.0
"""A region larger than so many pictures is none."""


class FaceFinder:
    """Follows one face: the largest that it finds, until it is lost.

    Attributes:
        landmarks: Of the last picture, pixels, float32 ``[478, 3]``; None if there is no face.
    """

    def __init__(self, networks: FaceNetworks) -> None:
        self.landmarks: FloatArray | None = None
        self._networks = networks

    def find(self, picture: Image.Image, time_s: float | None) -> TrackerSample:
        """Take the next picture, RGB and not mirrored, and when it was taken by its camera."""
        # Where the face was a moment ago, or, if it is not there any more, anywhere.
        former = None if self.landmarks is None else region_of(self.landmarks)
        if (former is None or not self._follow(picture, former)) and not any(
            self._follow(picture, each) for each in self._networks.detect(picture)
        ):
            return TrackerSample(tracker_s=time_s, has_face=False)
        assert self.landmarks is not None
        rotation, place_m = head_pose(self.landmarks, *picture.size)
        return TrackerSample(
            tracker_s=time_s,
            arkit=self._networks.shapes(self.landmarks),
            rotation=rotation,
            place_m=place_m,
        )

    def _follow(self, picture: Image.Image, region: Region) -> bool:
        """Look for the landmarks in a region of the picture."""
        self.landmarks = None
        if not 1 < region.side < MAX_SIDE * max(picture.size):
            return False
        landmarks, presence = self._networks.landmarks(picture, region)
        if presence >= PRESENT:
            self.landmarks = landmarks
        return self.landmarks is not None


REOPEN_S = 2.0
"""How often a camera that was pulled is looked for."""
PREVIEW_WIDTH = 320


class Webcam(Tracker):
    """A camera that is read from its making to `close`."""

    def __init__(
        self,
        device: str,
        networks: FaceNetworks,
        calibration: Calibration | None = None,
        tap: SampleTap | None = None,
    ) -> None:
        """Open a camera by its number or name, empty for the first, or a video instead of one.

        Raises:
            SourceError: It cannot be opened.
        """
        super().__init__(calibration, tap)
        self.finder = FaceFinder(networks)
        self._device = device
        self._is_video = device_of(device)[1] is None
        self._trouble = "webcam: no picture yet"
        self._picture: Image.Image | None = None
        self._container = open_camera(device)
        self._thread.start()

    @property
    def trouble(self) -> str:
        """Say what is wrong, see `Tracker.trouble`."""
        return self._trouble

    def preview(self) -> Picture | None:
        """What the camera sees, as in a mirror, with the landmarks in it; never sent. uint8
        ``[H, W, 3]``, 320 columns; None before the first picture."""
        picture, landmarks = self._picture, self.finder.landmarks
        if picture is None:
            return None
        scale = PREVIEW_WIDTH / picture.width
        small = picture.resize((PREVIEW_WIDTH, max(round(picture.height * scale), 1)))
        if landmarks is not None:
            draw = ImageDraw.Draw(small)
            draw.point([(x * scale, y * scale) for x, y, _ in landmarks.tolist()], (90, 255, 160))
        return np.asarray(small)[:, ::-1].copy()

    def _read(self) -> None:
        while not self._closing.is_set():
            reason = f"gives no more pictures (of {MAX_PIXELS:,} pixels at most)"
            try:
                self._show()
            except Exception as error:  # whatever a camera or a network throws, the call goes on
                reason = f"cannot be read: {error}"
            self._container.close()
            if self._closing.is_set():
                return
            self._trouble = f"webcam: {device_of(self._device)[0]} {reason}"
            self._reopen()

    def _show(self) -> None:
        """Take pictures until there are no more."""
        for picture, time_s in pictures(self._container, self._is_video, self._closing.wait):
            began_s = time.monotonic()
            sample = self.finder.find(picture, time_s)
            self._picture = picture
            self._trouble = "" if sample.has_face else "webcam: no face in the picture"
            self._push(sample, began_s)

    def _reopen(self) -> None:
        """Wait until the camera is there again."""
        while not self._closing.wait(REOPEN_S):
            with suppress(SourceError):
                self._container = open_camera(self._device)
                return
