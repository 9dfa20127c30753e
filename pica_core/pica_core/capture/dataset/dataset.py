"""Read a capture lazily: nothing is decoded before it is asked for, and nothing is kept.

    capture = Capture.open("capture")
    for frame in capture.frames_of("train"):
        capture.vertices_m(frame), capture.image(frame, "front")

Every problem is a `CaptureError` that names the file and what is wrong with it; frames whose files
are missing or cut short are left out when the capture is opened, counted and told of once.

A Multiface directory as it was published (Wuu et al. 2022, arXiv 2207.11243) has no `capture.json`,
no topology and no expressions: topology is found from the first tracked OBJ, image size from the
first image, and the split holds out whole segments. Audio is left alone. Nothing of that data set
is part of this project; it has a licence of its own (CC BY-NC 4.0).
"""

import logging
import re
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pica_core.camera import Camera
from pica_core.capture.dataset import files, multiface
from pica_core.capture.dataset.files import CaptureFrame, Topology
from pica_core.errors import CaptureError
from pica_core.types import Array, ByteArray, Float64Array, FloatArray, Int64Array

log = logging.getLogger(__name__)

HELD_OUT_EVERY = 10
"""Segments, in the order of their names, of which the fifth is for testing."""


def is_published(root: Path) -> bool:
    """Whether a directory without `capture.json` looks like a published one."""
    return all((root / name).exists() for name in (multiface.KRT, "images", "tracked_mesh"))


def describe_published(root: Path) -> tuple[dict[str, Any], tuple[CaptureFrame, ...]]:
    """What `capture.json` and the tables would say."""
    path = root / multiface.FRAME_LIST
    names: dict[tuple[str, str], None] = {}
    for number, line in enumerate(multiface.read_text(path).splitlines(), start=1):
        if words := line.split():
            segment, name = words if len(words) == 2 else (line, "")
            files.check_frame_name(f"{path}:{number}", segment, name, names)
            names[segment, name] = None
    if not names:
        raise CaptureError(f"{path}: no frames")
    segments = sorted({segment for segment, _ in names})
    middle = min(HELD_OUT_EVERY // 2, len(segments) - 1)
    held_out = segments[middle::HELD_OUT_EVERY] if len(segments) > 1 else []
    frames = tuple(
        CaptureFrame(segment=segment, name=name, split="test" if segment in held_out else "train")
        for segment, name in names
    )
    width, height = _image_size(root)
    info = {
        "schema": multiface.SCHEMA,
        "source": "a directory in the layout of the Multiface dataset",
        "licence": "that of its publisher",
        "width": width,
        "height": height,
        "texture_size": _texture_size(root),
    }
    return info, frames


def _image_size(root: Path) -> tuple[int, int]:
    for path in (root / "images").glob("*/*/*.png"):
        try:
            height, width, _ = files.load_image(path, "RGB", None).shape
            return width, height
        except CaptureError:
            continue
    raise CaptureError(f"{root / 'images'}: no image to take the size of")


def _texture_size(root: Path) -> int:
    for path in sorted(root.glob("unwrapped_uv_*")):
        found = re.fullmatch(r"unwrapped_uv_(\d{1,4})", path.name)
        if found and int(found.group(1)) > 0:
            return int(found.group(1))
    raise CaptureError(f"{root}: no unwrapped_uv_SIZE directory")


class ObjMesh(NamedTuple):
    """The mesh of an OBJ file.

    Attributes:
        points: Vertices. ``[V, 3]``.
        uv: Texture coordinates, v upwards. ``[T, 2]``.
        faces: Vertex and texture coordinate of each triangle's corners. ``[F, 3, 2]``.
    """

    points: Float64Array
    uv: Float64Array
    faces: Int64Array


def read_obj(path: Path) -> ObjMesh:
    """Read ``v``, ``vt`` and ``f`` of an OBJ file; polygons become fans of triangles.

    Raises:
        CaptureError: A line that is cut, or a corner without a texture coordinate.

    Not checked: that corners lie within the vertices.
    """
    lines: dict[bytes, list[Any]] = {b"v": [], b"vt": [], b"f": []}
    for line in multiface.read_bytes(path).splitlines():
        head, _, rest = line.strip().partition(b" ")
        if head in lines:
            lines[head].append(rest.split())
    corners = []
    try:
        for polygon in lines[b"f"]:
            ends = [[int(number) - 1 for number in word.split(b"/")[:2]] for word in polygon]
            corners += [(ends[0], *ends[k : k + 2]) for k in range(1, len(ends) - 1)]
        return ObjMesh(
            np.array([words[:3] for words in lines[b"v"]], np.float64).reshape(-1, 3),
            np.array([words[:2] for words in lines[b"vt"]], np.float64).reshape(-1, 2),
            np.array(corners, np.int64).reshape(-1, 3, 2),
        )
    except ValueError as error:
        raise CaptureError(f"{path}: a line cannot be read ({error})") from error


def published_topology(
    root: Path, frames: tuple[CaptureFrame, ...]
) -> tuple[Topology, Int64Array, int]:
    """Topology of the first OBJ, the OBJ's vertex for each of its vertices, and how many it has."""
    for frame in frames:
        path = (root / multiface.mesh_path(frame.segment, frame.name)).with_suffix(".obj")
        if path.is_file():
            break
    else:
        where = root / "tracked_mesh"
        raise CaptureError(f"{where}: no OBJ of a listed frame to take the topology of")
    obj = read_obj(path)
    count, limits = len(obj.points), (len(obj.points), len(obj.uv))
    if not len(obj.faces) or (obj.faces < 0).any() or (obj.faces >= limits).any():
        raise CaptureError(
            f"{path}: triangles of {count} vertices and {len(obj.uv)} texture coordinates are "
            "needed"
        )
    pairs, faces = np.unique(obj.faces.reshape(-1, 2), axis=0, return_inverse=True)
    uv = obj.uv.astype(np.float32)[pairs[:, 1]]
    if not np.isfinite(uv).all():
        raise CaptureError(f"{path}: a texture coordinate is not finite")
    topology = Topology(vertex_uv=uv, faces=faces.reshape(-1, 3).astype(np.int32), regions={})
    return topology, np.ascontiguousarray(pairs[:, 0]), count


class Capture:
    """An opened capture directory; make one with `open`.

    Attributes:
        cameras: All cameras, in KRT order.
        frames: All frames that can be used, in the order of their list.
        has_truth: Exact meshes are there (synthetic captures).
        has_depth: Images come with depth.
        has_expressions: Frames come with their 52 values.
        is_published: A directory as published, without our additions.
        topology: The mesh that models draw.
        tracked_topology: The tracked mesh; the same object where a capture has one mesh only.
        dense_vertex: Which vertex of `topology` each tracked vertex is, int64 ``[Vt]``.
        texture_size: Side of the average textures, texels.
    """

    def __init__(self, path: Path) -> None:
        where = path / multiface.CAPTURE
        self.path = path
        self.is_published = not where.is_file()
        self._mesh_vertex: Int64Array | slice = slice(None)
        if self.is_published:
            self.info, frames = describe_published(path)
            topology, self._mesh_vertex, self._num_mesh_vertices = published_topology(path, frames)
            self.topology = self.tracked_topology = topology
            self.dense_vertex: Int64Array = np.arange(len(topology.vertex_uv))
        else:
            self.info = multiface.read_json(where)
            schema = self.info.get("schema")
            if schema != multiface.SCHEMA:
                raise CaptureError(f"{where}: schema is {schema!r}; {multiface.SCHEMA} is known")
            self.topology, self.tracked_topology, self.dense_vertex = files.read_topology(
                path / multiface.TOPOLOGY
            )
            self._num_mesh_vertices = len(self.tracked_topology.vertex_uv)
            frames = files.read_frames(path / multiface.EXPRESSIONS)
        sizes: list[Any] = [self.info.get(name) for name in ("width", "height", "texture_size")]
        if not all(isinstance(size, int) and 0 < size <= 8192 for size in sizes):
            raise CaptureError(
                f"{where}: width, height and texture_size are {sizes}; 1 to 8192 are allowed"
            )
        width, height, self.texture_size = sizes
        self.cameras = multiface.read_krt(path / multiface.KRT, width, height)
        self._cameras = {camera.name: camera for camera in self.cameras}
        self.has_truth = (path / multiface.TRUTH_MESH).is_dir()
        self.has_depth = (path / "depth").is_dir()
        self.has_expressions = frames[0].arkit is not None
        images = path / "images"
        self._listed = cache(lambda *at: {each.stem for each in images.joinpath(*at).glob("*.png")})
        self.frames = self._usable(frames)

    def _usable(self, listed: tuple[CaptureFrame, ...]) -> tuple[CaptureFrame, ...]:
        problems = [self._incomplete(frame) for frame in listed]
        self.left_out = tuple(problem for problem in problems if problem is not None)
        kept = [frame for frame, problem in zip(listed, problems, strict=True) if problem is None]
        if not kept:
            raise CaptureError(f"{self.left_out[0]}; no frame of the capture is complete")
        if self.left_out:
            log.warning(
                "%s: %d of %d frames are left out, the first because of %s",
                self.path, len(self.left_out), len(listed), self.left_out[0],
            )  # fmt: skip
        return tuple(kept)

    def _incomplete(self, frame: CaptureFrame) -> str | None:
        """Why a frame cannot be used, from names and sizes alone; None if it can."""
        mesh = self.path / multiface.mesh_path(frame.segment, frame.name)
        wanted = 12 * self._num_mesh_vertices
        try:
            size = mesh.stat().st_size
        except OSError as error:
            return f"{mesh}: {error.strerror}"
        if size != wanted:
            return f"{mesh}: {size} bytes; {self._num_mesh_vertices} vertices need {wanted}"
        for path in (
            multiface.transform_path(frame.segment, frame.name),
            multiface.texture_path(self.texture_size, frame.segment, frame.name),
        ):
            if not (self.path / path).is_file():
                return f"{self.path / path}: the file is missing"
        return None

    @classmethod
    def open(cls, path: str | Path) -> "Capture":
        """Open a capture directory and check what describes it; images and meshes are checked when
        read.

        Args:
            path: The directory: one of ours, or a Multiface directory as published. The latter
                states no split: of every ten segments the fifth is held out.
        """
        root = Path(path)
        if not root.is_dir():
            raise CaptureError(f"{root}: no such directory")
        is_ours = (root / multiface.CAPTURE).is_file()
        if not is_ours and ((root / multiface.MARKER).exists() or not is_published(root)):
            raise CaptureError(
                f"{root}: no {multiface.CAPTURE}; not a capture, or one that is not finished"
            )
        return cls(root)

    @property
    def identity(self) -> str:
        """Name of the captured person; the directory's name where nothing says it."""
        return str(self.info.get("head", self.path.name))

    def frames_of(self, split: str) -> tuple[CaptureFrame, ...]:
        """The frames of one of `SPLITS`."""
        return tuple(frame for frame in self.frames if frame.split == split)

    def camera(self, name: str) -> Camera:
        """A camera by name, in the world; `head_camera` is the one that meshes are seen with."""
        if name not in self._cameras:
            known = ", ".join(self._cameras)
            raise CaptureError(f"{self.path}: no camera {name!r}; there are {known}")
        return self._cameras[name]

    def cameras_of(self, frame: CaptureFrame) -> tuple[str, ...]:
        """Cameras that have an image of a frame; a frame may be missing from some."""
        return tuple(n for n in self._cameras if frame.name in self._listed(frame.segment, n))

    def image(self, frame: CaptureFrame, camera: str) -> ByteArray:
        """sRGB image as stored, row 0 on top. uint8 ``[H, W, 3]``."""
        return self._load("images", "RGB", frame, camera)

    def depth_m(self, frame: CaptureFrame, camera: str) -> FloatArray:
        """Depth along the camera axis at pixel centres, 0 where empty. float32 ``[H, W]``."""
        units = self._load("depth", "I;16", frame, camera)
        return units.astype(np.float32) * np.float32(multiface.DEPTH_UNIT_M)

    def _load(self, kind: str, mode: str, frame: CaptureFrame, camera: str) -> Array:
        view = self.camera(camera)
        path = self.path / multiface.image_path(kind, frame.segment, camera, frame.name)
        return files.load_image(path, mode, (view.width, view.height))

    def vertices_m(self, frame: CaptureFrame) -> FloatArray:
        """Tracked mesh on `tracked_topology`, head frame, metres. float32 ``[Vt, 3]``."""
        path = self.path / multiface.mesh_path(frame.segment, frame.name)
        return files.read_vertices(path, self._num_mesh_vertices)[self._mesh_vertex]

    def true_vertices_m(self, frame: CaptureFrame) -> FloatArray:
        """Exact mesh on `topology`, head frame, metres. float32 ``[V, 3]``."""
        path = self.path / multiface.mesh_path(frame.segment, frame.name, multiface.TRUTH_MESH)
        return files.read_vertices(path, len(self.topology.vertex_uv))

    def head_to_world(self, frame: CaptureFrame) -> Float64Array:
        """Rotation and translation (metres) from head frame to world. float64 ``[3, 4]``."""
        return files.read_transform(self.path / multiface.transform_path(frame.segment, frame.name))

    def head_camera(self, frame: CaptureFrame, name: str) -> Camera:
        """A camera in the frame's head axes: it projects the frame's meshes as they are."""
        return self.camera(name).in_head(self.head_to_world(frame))

    def average_texture(self, frame: CaptureFrame) -> ByteArray:
        """Average texture, row 0 is v = 0, black where no camera looked. uint8 ``[S, S, 3]``."""
        path = multiface.texture_path(self.texture_size, frame.segment, frame.name)
        size = (self.texture_size, self.texture_size)
        return np.ascontiguousarray(files.load_image(self.path / path, "RGB", size)[::-1])
