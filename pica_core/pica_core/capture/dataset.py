"""Read a capture lazily: nothing is decoded before it is asked for, and nothing is kept.

    capture = Capture.open("capture")
    for frame in capture.frames_of("train"):
        capture.vertices_m(frame), capture.image(frame, "front")

Every problem is a `CaptureError` that names the file and what is wrong with it.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, UnidentifiedImageError

from pica_core.arkit import ARKIT_NAMES, NUM_ARKIT
from pica_core.camera import Camera
from pica_core.capture import multiface
from pica_core.capture.head_motion import camera_in_head
from pica_core.errors import CaptureError

FloatArray = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]
IntArray = npt.NDArray[np.int32]
BoolArray = npt.NDArray[np.bool_]

SPLITS = ("train", "test")
MAX_IMAGE_PIXELS = 64_000_000
"""Larger images are refused before decoding."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CaptureFrame:
    """One moment of a capture."""

    index: int
    """Place in `Capture.frames`."""
    segment: str
    """Take that the frame belongs to."""
    name: str
    """Frame name within its take."""
    split: str
    """``train`` or ``test``."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Topology:
    """What all meshes of a capture share.

    Attributes:
        vertex_uv: Texture coordinates, v = 0 is row 0. float32 ``[V, 2]``.
        faces: Triangles, counter-clockwise from outside. int32 ``[F, 3]``.
        regions: Named vertex sets (`heads.Head.regions`). bool ``[V]`` each.
    """

    vertex_uv: FloatArray
    faces: IntArray
    regions: dict[str, BoolArray]


def _load_image(path: Path, mode: str, size: tuple[int, int]) -> npt.NDArray[Any]:
    try:
        with Image.open(path) as image:
            if image.width * image.height > MAX_IMAGE_PIXELS:
                raise CaptureError(f"{path}: {image.width}x{image.height} pixels are too many")
            if image.size != size:
                raise CaptureError(
                    f"{path}: the image is {image.width}x{image.height}, "
                    f"{size[0]}x{size[1]} is needed"
                )
            if mode == "I;16":
                if not image.mode.startswith("I"):
                    raise CaptureError(f"{path}: a 16-bit image is needed, found {image.mode}")
                return np.asarray(image).astype(np.uint16)
            return np.asarray(image.convert(mode))
    except FileNotFoundError:
        raise CaptureError(f"{path}: the file is missing") from None
    except (UnidentifiedImageError, OSError, SyntaxError) as error:
        raise CaptureError(f"{path}: not a complete image ({error})") from error


def _field(values: dict[str, Any], path: Path, name: str, kind: type) -> Any:
    value = values.get(name)
    if not isinstance(value, kind):
        raise CaptureError(f"{path}: field {name!r} is {value!r}; {kind.__name__} is needed")
    return value


class Capture:
    """An opened capture directory; make one with `open`.

    Attributes:
        path: Its directory.
        info: `capture.json` as read.
        cameras: All cameras, in KRT order.
        frames: All frames, in `frame_list.txt` order.
        topology: The mesh that models draw.
        tracked_topology: The tracked mesh; the same object where a capture has one mesh only.
        has_truth: Exact meshes and exact depth are there (synthetic captures).
        has_depth: At least one frame has depth.
        texture_size: Side of the average textures, texels.
    """

    def __init__(
        self,
        path: Path,
        info: dict[str, Any],
        cameras: tuple[Camera, ...],
        frames: tuple[CaptureFrame, ...],
        topology: Topology,
        tracked_topology: Topology,
        arkit: FloatArray,
        texture_size: int,
    ) -> None:
        self.path = path
        self.info = info
        self.cameras = cameras
        self.frames = frames
        self.topology = topology
        self.tracked_topology = tracked_topology
        self.has_truth = (path / multiface.TRUTH_MESH).is_dir()
        self.has_depth = (path / "depth").is_dir()
        self.texture_size = texture_size
        self._arkit = arkit
        self._cameras = {camera.name: camera for camera in cameras}

    @classmethod
    def open(cls, path: str | Path) -> Capture:
        """Open a capture directory and check what describes it; images and meshes are checked when
        read.

        Raises:
            CaptureError: The directory or a describing file is missing, damaged or inconsistent.
        """
        root = Path(path)
        if not root.is_dir():
            raise CaptureError(f"{root}: no such directory")
        if not (root / multiface.CAPTURE).is_file():
            raise CaptureError(
                f"{root}: no {multiface.CAPTURE}; not a capture, or one that is not finished"
            )
        where = root / multiface.CAPTURE
        info = multiface.read_json(where)
        if info.get("schema") != multiface.SCHEMA:
            raise CaptureError(
                f"{where}: schema is {info.get('schema')!r}; {multiface.SCHEMA} is known"
            )
        width, height = (_field(info, where, name, int) for name in ("width", "height"))
        texture_size = _field(info, where, "texture_size", int)
        if not (0 < width <= 8192 and 0 < height <= 8192 and 0 < texture_size <= 8192):
            raise CaptureError(
                f"{where}: sizes {width}x{height}, texture {texture_size}: 1 to 8192 are allowed"
            )
        cameras = multiface.read_krt(root / multiface.KRT, width, height)
        topology = _read_topology(root / multiface.TOPOLOGY)
        tracked = topology
        if (root / multiface.TRACKED_TOPOLOGY).is_file():
            tracked = _read_topology(root / multiface.TRACKED_TOPOLOGY)
        frames, arkit = _read_frames(root)
        return cls(root, info, cameras, frames, topology, tracked, arkit, texture_size)

    @property
    def num_vertices(self) -> int:
        """V, of `topology`."""
        return len(self.topology.vertex_uv)

    def frames_of(self, split: str) -> tuple[CaptureFrame, ...]:
        """The frames of one split.

        Raises:
            CaptureError: The split is neither ``train`` nor ``test``.
        """
        if split not in SPLITS:
            raise CaptureError(f"split {split!r} is unknown; {', '.join(SPLITS)} are known")
        return tuple(frame for frame in self.frames if frame.split == split)

    def camera(self, name: str) -> Camera:
        """A camera by name, in the world; `head_camera` is the one that meshes are seen with.

        Raises:
            CaptureError: No such camera.
        """
        try:
            return self._cameras[name]
        except KeyError:
            raise CaptureError(
                f"{self.path}: no camera {name!r}; there are {', '.join(self._cameras)}"
            ) from None

    def arkit(self, frame: CaptureFrame) -> FloatArray:
        """The frame's shapes in `ARKIT_NAMES` order. float32 ``[52]``."""
        values: FloatArray = self._arkit[frame.index]
        return values

    def image(self, frame: CaptureFrame, camera: str) -> ByteArray:
        """sRGB image, row 0 on top. uint8 ``[H, W, 3]``."""
        view = self.camera(camera)
        path = self.path / multiface.image_path("images", frame.segment, camera, frame.name)
        return _load_image(path, "RGB", (view.width, view.height))

    def mask(self, frame: CaptureFrame, camera: str) -> ByteArray:
        """0 for background, else material id + 1 at the pixel's centre. uint8 ``[H, W]``."""
        view = self.camera(camera)
        path = self.path / multiface.image_path("mask", frame.segment, camera, frame.name)
        return _load_image(path, "L", (view.width, view.height))

    def has_depth_of(self, frame: CaptureFrame) -> bool:
        """Whether a frame has depth: a method may have been run on some of them only."""
        return (self.path / "depth" / frame.segment).is_dir() and any(
            (self.path / multiface.image_path("depth", frame.segment, name, frame.name)).is_file()
            for name in self._cameras
        )

    def depth_m(self, frame: CaptureFrame, camera: str) -> FloatArray:
        """Depth along the camera axis at pixel centres as a method found it, 0 where unknown.
        float32 ``[H, W]``."""
        return self._read_depth("depth", frame, camera)

    def true_depth_m(self, frame: CaptureFrame, camera: str) -> FloatArray:
        """Exact depth along the camera axis at pixel centres, 0 where empty. float32 ``[H, W]``.

        Raises:
            CaptureError: The capture has no truth, or the file is damaged.
        """
        self._need_truth()
        return self._read_depth(multiface.TRUTH_DEPTH, frame, camera)

    def _read_depth(self, kind: str, frame: CaptureFrame, camera: str) -> FloatArray:
        view = self.camera(camera)
        path = self.path / multiface.image_path(kind, frame.segment, camera, frame.name)
        units = _load_image(path, "I;16", (view.width, view.height))
        return units.astype(np.float32) * np.float32(multiface.DEPTH_UNIT_M)

    def _need_truth(self) -> None:
        if not self.has_truth:
            raise CaptureError(
                f"{self.path}: no {multiface.TRUTH_MESH}; only synthetic captures hold the truth"
            )

    def vertices_m(self, frame: CaptureFrame) -> FloatArray:
        """Tracked mesh on `tracked_topology`, head frame, metres. float32 ``[Vt, 3]``."""
        path = self.path / multiface.mesh_path(frame.segment, frame.name)
        return _read_vertices(path, len(self.tracked_topology.vertex_uv))

    def true_vertices_m(self, frame: CaptureFrame) -> FloatArray:
        """Exact mesh on `topology`, head frame, metres. float32 ``[V, 3]``.

        Raises:
            CaptureError: The capture has no truth, or the file is damaged.
        """
        self._need_truth()
        path = self.path / multiface.mesh_path(frame.segment, frame.name, multiface.TRUTH_MESH)
        return _read_vertices(path, len(self.topology.vertex_uv))

    def mean_vertices_m(self) -> FloatArray:
        """Mean tracked mesh over the training frames, metres. float32 ``[Vt, 3]``."""
        return _read_vertices(self.path / "vert_mean.bin", len(self.tracked_topology.vertex_uv))

    def head_to_world(self, frame: CaptureFrame) -> npt.NDArray[np.float64]:
        """Rotation and translation (metres) from head frame to world. float64 ``[3, 4]``."""
        path = self.path / multiface.transform_path(frame.segment, frame.name)
        try:
            matrix = np.array(
                [
                    [float(w) for w in line.split()]
                    for line in multiface.read_text(path).splitlines()
                ]
            )
        except ValueError:
            matrix = np.zeros(0)
        if matrix.shape != (3, 4) or not np.isfinite(matrix).all():
            raise CaptureError(f"{path}: three lines of four numbers are needed")
        matrix[:, 3] /= multiface.MILLIMETRES
        return matrix

    def head_camera(self, frame: CaptureFrame, name: str) -> Camera:
        """A camera in the frame's head axes: it projects the frame's meshes as they are.

        Raises:
            CaptureError: No such camera, or no head pose.
        """
        return camera_in_head(self.camera(name), self.head_to_world(frame))

    def average_texture(self, frame: CaptureFrame) -> ByteArray:
        """Average texture, row 0 is v = 0, black where no camera looked. uint8 ``[S, S, 3]``."""
        path = self.path / multiface.texture_path(self.texture_size, frame.segment, frame.name)
        size = (self.texture_size, self.texture_size)
        return np.ascontiguousarray(_load_image(path, "RGB", size)[::-1])

    def mean_texture(self) -> ByteArray:
        """Mean texture over the training frames, row 0 is v = 0. uint8 ``[S, S, 3]``."""
        size = (self.texture_size, self.texture_size)
        return np.ascontiguousarray(_load_image(self.path / "tex_mean.png", "RGB", size)[::-1])


def _read_vertices(path: Path, count: int) -> FloatArray:
    """A mesh file of `count` vertices, in metres."""
    wanted = 12 * count
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise CaptureError(f"{path}: the file is missing") from None
    except OSError as error:
        raise CaptureError(f"{path}: cannot read ({error})") from error
    if len(data) != wanted:
        raise CaptureError(f"{path}: {len(data)} bytes; {count} vertices need {wanted} (float32)")
    vertices = np.frombuffer(data, "<f4").reshape(-1, 3) / np.float32(multiface.MILLIMETRES)
    if not np.isfinite(vertices).all():
        raise CaptureError(f"{path}: vertices are not all finite")
    return vertices.astype(np.float32)


def read_tracked(root: Path) -> tuple[Topology, npt.NDArray[np.int64]]:
    """The tracked mesh of a synthetic capture, and the dense vertex that each of its vertices is.

    Raises:
        CaptureError: Missing or damaged.
    """
    path = root / multiface.TRACKED_TOPOLOGY
    topology = _read_topology(path)
    index = _read_arrays(path).get("dense_vertex", np.zeros(0))
    if index.shape != (len(topology.vertex_uv),) or index.dtype.kind != "i" or index.min() < 0:
        raise CaptureError(f"{path}: field 'dense_vertex' is no index for each vertex")
    return topology, index.astype(np.int64)


def _read_arrays(path: Path) -> dict[str, npt.NDArray[Any]]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise CaptureError(f"{path}: the file is missing") from None
    except (OSError, ValueError, EOFError) as error:
        raise CaptureError(f"{path}: not a complete archive ({error})") from error
    except Exception as error:  # zipfile and zlib have error classes of their own
        raise CaptureError(f"{path}: damaged archive ({error})") from error


def _read_topology(path: Path) -> Topology:
    arrays = _read_arrays(path)
    for name in ("vertex_uv", "faces"):
        if name not in arrays:
            raise CaptureError(f"{path}: field {name!r} is missing")
    uv, faces = arrays["vertex_uv"], arrays["faces"]
    if uv.ndim != 2 or uv.shape[1] != 2 or not np.isfinite(uv).all():
        raise CaptureError(f"{path}: field 'vertex_uv' is {uv.shape}; finite [V, 2] is needed")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.min() < 0 or faces.max() >= len(uv):
        raise CaptureError(
            f"{path}: field 'faces' is {faces.shape} or points outside {len(uv)} vertices"
        )
    regions = {
        name.removeprefix("region_"): value.astype(np.bool_)
        for name, value in arrays.items()
        if name.startswith("region_")
    }
    for name, value in regions.items():
        if value.shape != (len(uv),):
            raise CaptureError(f"{path}: region {name!r} is {value.shape}; [{len(uv)}] is needed")
    return Topology(vertex_uv=uv.astype(np.float32), faces=faces.astype(np.int32), regions=regions)


def _read_frames(root: Path) -> tuple[tuple[CaptureFrame, ...], FloatArray]:
    table_path, list_path = root / multiface.EXPRESSIONS, root / multiface.FRAME_LIST
    rows = list(csv.reader(io.StringIO(multiface.read_text(table_path))))
    header = rows[0] if rows else []
    missing = [name for name in ("segment", "frame", "split", *ARKIT_NAMES) if name not in header]
    if missing:
        raise CaptureError(f"{table_path}: column {missing[0]!r} is missing")
    place = [header.index(name) for name in ARKIT_NAMES]
    table: dict[tuple[str, str], tuple[str, list[float]]] = {}
    for number, row in enumerate(rows[1:], start=2):
        try:
            values = [float(row[at]) for at in place]
            split = row[header.index("split")]
            key = (row[header.index("segment")], row[header.index("frame")])
        except (IndexError, ValueError) as error:
            raise CaptureError(f"{table_path}:{number}: row cannot be read ({error})") from error
        if split not in SPLITS or not np.isfinite(values).all():
            raise CaptureError(
                f"{table_path}:{number}: split is {split!r}, or a value is not finite"
            )
        table[key] = (split, values)
    frames: list[CaptureFrame] = []
    arkit: list[list[float]] = []
    for number, line in enumerate(multiface.read_text(list_path).splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        if len(words) != 2 or (words[0], words[1]) not in table:
            raise CaptureError(
                f"{list_path}:{number}: {line!r} has no row in {multiface.EXPRESSIONS}"
            )
        split, values = table[words[0], words[1]]
        frames.append(CaptureFrame(index=len(frames), segment=words[0], name=words[1], split=split))
        arkit.append(values)
    if not frames:
        raise CaptureError(f"{list_path}: no frames")
    return tuple(frames), np.array(arkit, np.float32).reshape(-1, NUM_ARKIT)
