"""Read a capture lazily: nothing is decoded before it is asked for, and nothing is kept.

    capture = Capture.open("capture")
    for frame in capture.frames_of("train"):
        capture.vertices_m(frame), capture.image(frame, "front")

Every problem is a `CaptureError` that names the file and what is wrong with it; frames whose files
are missing or cut short are left out when the capture is opened, counted and told of once.

A Multiface directory as it was published (Wuu et al. 2022, arXiv 2207.11243) has no `capture.json`,
no topology and no expressions: topology is found from the first tracked OBJ, image size from the
first image, and the split holds out whole segments. Audio is left alone. Nothing of that data set
is part of this project; it has a licence of its own (CC BY-NC 4.0). One of Ava-256 is alike, as
`ava` says.

Such directories have neither expressions nor our head frame; `capture expressions` finds both
and keeps them beside the data, in `FITTED` and ``expressions.csv``.
"""

import logging
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pica_core.camera import Camera
from pica_core.capture.dataset import ava, files, multiface
from pica_core.capture.dataset.files import CaptureFrame, Topology
from pica_core.capture.dataset.members import Member, read_members
from pica_core.errors import CaptureError
from pica_core.types import Array, BoolArray, ByteArray, Float64Array, FloatArray, Int64Array

log = logging.getLogger(__name__)

HELD_OUT_EVERY = 10
"""Segments, in the order of their names, of which the fifth is for testing."""
FITTED = "fitted.npz"
"""Our head frame, and vertex regions, of a published directory."""
NERSEMBLE = Path("calibration") / "camera_params.json"
TRIED = 4
"""Images of each zip file that are tried for their size."""


def is_published(root: Path) -> bool:
    """Whether a directory without `capture.json` looks like a published one."""
    is_multiface = all((root / n).exists() for n in (multiface.KRT, "images", "tracked_mesh"))
    return is_multiface or (root / ava.CALIBRATION).is_file()


def _published_frames(
    path: Path, rows: Iterable[tuple[int, list[str]]], held_out: str = ""
) -> tuple[CaptureFrame, ...]:
    """The frames of a list of line, segment and name."""
    names: dict[tuple[str, str], None] = {}
    for number, words in rows:
        segment, name = words if len(words) == 2 else (*words, "")
        files.check_frame_name(f"{path}:{number}", segment, name, names)
        names[segment, name] = None
    if not names:
        raise CaptureError(f"{path}: no frames")
    segments = sorted({segment for segment, _ in names})
    middle = min(HELD_OUT_EVERY // 2, len(segments) - 1)
    test = segments[middle::HELD_OUT_EVERY] if len(segments) > 1 else []
    test = [held_out] if test and held_out in segments else test
    return tuple(
        CaptureFrame(segment=segment, name=name, split="test" if segment in test else "train")
        for segment, name in names
    )


def _first_size(images: Iterable[Path | Member], where: Path) -> tuple[int, int]:
    """Rows and columns of the first image that can be read."""
    for image in images:
        try:
            height, width, _ = files.load_image(image, "RGB", None).shape
            return height, width
        except CaptureError:
            continue
    raise CaptureError(f"{where}: no image to take the size of; download some")


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


def published_topology(path: Path) -> tuple[Topology, Int64Array, int]:
    """Topology of an OBJ, the OBJ's vertex for each of its vertices, and how many it has."""
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
        cameras: All cameras that have images, in the order of their calibration.
        frames: All frames that can be used, in the order of their list.
        left_out: Why others cannot, and damaged files, a line each.
        num_listed: How many frames are listed.
        missing: Calibrated cameras that have no images.
        calibration: The file of the cameras.
        has_truth: Exact meshes are there (synthetic captures).
        has_depth: Images come with depth.
        has_masks: Images come with masks.
        has_expressions: Frames come with their 52 values.
        is_published: A directory as published, without our additions.
        topology: The mesh that models draw.
        tracked_topology: The tracked mesh; the same object where a capture has one mesh only.
        dense_vertex: Which vertex of `topology` each tracked vertex is, int64 ``[Vt]``.
        texture_size: Side of the average textures, texels.
    """

    def __init__(self, path: Path, *, take_fit: bool = True) -> None:
        self.path = path
        self.missing: tuple[str, ...] = ()
        self.left_out: tuple[str, ...] = ()
        if (path / multiface.CAPTURE).is_file():
            self.is_published, frames = False, self._describe_ours()
        elif (path / ava.CALIBRATION).is_file():
            self.is_published, frames = True, self._describe_ava()
        else:
            self.is_published, frames = True, self._describe_multiface()
        self._cameras = {camera.name: camera for camera in self.cameras}
        self.has_truth = (path / multiface.TRUTH_MESH).is_dir()
        self.has_depth = (path / "depth").is_dir()
        self.num_listed, self._to_ours = len(frames), np.eye(3, 4)
        self._is_fitted = take_fit and self.is_published
        self._is_fitted &= (path / multiface.EXPRESSIONS).is_file()
        if self._is_fitted:
            frames = self._take_fit(frames)
        self.frames = self._usable(frames)
        self.has_expressions = self.frames[0].arkit is not None

    def _describe_ours(self) -> tuple[CaptureFrame, ...]:
        where = self.path / multiface.CAPTURE
        self.info = multiface.read_json(where)
        schema = self.info.get("schema")
        if schema != multiface.SCHEMA:
            raise CaptureError(f"{where}: schema is {schema!r}; {multiface.SCHEMA} is known")
        self.topology, self.tracked_topology, self.dense_vertex = files.read_topology(
            self.path / multiface.TOPOLOGY
        )
        self._mesh_vertex: Int64Array | slice = slice(None)
        self._num_mesh_vertices = len(self.tracked_topology.vertex_uv)
        self._take_folder(where)
        return files.read_frames(self.path / multiface.EXPRESSIONS)

    def _describe_multiface(self) -> tuple[CaptureFrame, ...]:
        path = self.path / multiface.FRAME_LIST
        lines = enumerate(multiface.read_text(path).splitlines(), start=1)
        rows = [
            (k, w if len(w := line.split()) == 2 else [line]) for k, line in lines if line.strip()
        ]
        frames = _published_frames(path, rows)
        images = self.path / "images"
        height, width = _first_size(images.glob("*/*/*.png"), images)
        self._set_info("Multiface", "that of its publisher", _texture_size(self.path))
        self.info |= {"width": width, "height": height}
        meshes = (multiface.part_path("tracked_mesh", f.segment, f.name) for f in frames)
        obj = next(
            (p for m in meshes if (p := (self.path / m).with_suffix(".obj")).is_file()), None
        )
        if obj is None:
            where = self.path / "tracked_mesh"
            raise CaptureError(f"{where}: no OBJ of a listed frame to take the topology of")
        self._take_obj(obj)
        self._take_folder(path)
        return frames

    def _take_folder(self, where: Path) -> None:
        """Take over sizes, cameras, and where files are."""
        sizes: list[Any] = [self.info.get(name) for name in ("width", "height", "texture_size")]
        if not all(isinstance(size, int) and 0 < size <= 8192 for size in sizes):
            raise CaptureError(
                f"{where}: width, height and texture_size are {sizes}; 1 to 8192 are allowed"
            )
        width, height, self.texture_size = sizes
        self.calibration, self.has_masks = self.path / multiface.KRT, False
        self.cameras = multiface.read_krt(self.calibration, width, height)
        images = self.path / "images"
        listed = cache(lambda *at: {each.stem for each in images.joinpath(*at).glob("*.png")})
        self._has_image: Callable[[CaptureFrame, str], bool] = lambda frame, camera: (
            frame.name in listed(frame.segment, camera)
        )

        size = self.texture_size
        self._at: Callable[..., Path | Member] = lambda kind, frame, camera="": (
            self.path / multiface.part_path(kind, frame.segment, frame.name, camera, size=size)
        )

    def _describe_ava(self) -> tuple[CaptureFrame, ...]:
        root = self.path
        obj = next((p for at in (root, root.parent) if (p := at / ava.TOPOLOGY).is_file()), None)
        if obj is None:
            raise CaptureError(
                f"{root / ava.TOPOLOGY}: the file is missing; download the data set's, once for "
                "all people, and put it there or into the folder above"
            )
        self._take_obj(obj)
        parts = {kind: read_members(root / name) for kind, name in ava.PARTS.items()}
        zips: dict[str, dict[str, dict[str, Member]]] = {kind: {} for kind in ava.CAMERAS}
        for kind, name in ava.CAMERAS.items():
            for path in sorted((root / name).glob("cam*.zip")):
                try:
                    zips[kind][path.stem.removeprefix("cam")] = read_members(path)
                except CaptureError as error:
                    self.left_out += (str(error),)
                    log.warning("%s", error)
        images, self.has_masks = zips["images"], bool(zips["mask"])
        where = root / ava.CAMERAS["images"]
        some = (member for each in images.values() for member in list(each.values())[:TRIED])
        height, width = _first_size(some, where)
        if abs(width - height * ava.FULL_COLUMNS / ava.FULL_ROWS) > 1:
            raise CaptureError(
                f"{where}: images are {width}x{height}; {ava.FULL_COLUMNS}x{ava.FULL_ROWS} or a "
                "part of it is needed, as calibrated"
            )
        side, _ = _first_size(parts["texture"].values(), root / ava.PARTS["texture"])
        self._set_info("Ava-256", "CC BY-NC 4.0, as Ava-256", side)
        self.texture_size, self.calibration = side, root / ava.CALIBRATION
        calibrated = ava.read_calibration(self.calibration, width, height)
        self.cameras = tuple(each for each in calibrated if each.name in images)
        self.missing = tuple(each.name for each in calibrated if each.name not in images)
        if self.missing:
            log.warning("%s: no images of %d more cameras", where, len(self.missing))

        def at(kind: str, frame: CaptureFrame, camera: str = "") -> Member:
            members = zips[kind].get(camera, {}) if camera else parts[kind]
            where = root / (f"{ava.CAMERAS[kind]}/cam{camera}.zip" if camera else ava.PARTS[kind])
            return members.get(frame.name) or Member(where, frame.name)

        self._at = at
        self._has_image = lambda frame, camera: frame.name in images[camera]
        path = root / ava.FRAME_LIST
        return _published_frames(path, ava.read_list(path), ava.HELD_OUT)

    def _set_info(self, name: str, licence: str, texture_size: int) -> None:
        self.info = {
            "schema": multiface.SCHEMA,
            "source": f"a directory in the layout of the {name} dataset",
            "licence": licence,
            "texture_size": texture_size,
        }

    def _take_obj(self, path: Path) -> None:
        """Take over a topology: of each vertex of ours, which of the OBJ's it is."""
        topology, self._mesh_vertex, self._num_mesh_vertices = published_topology(path)
        self.topology = self.tracked_topology = topology
        self.dense_vertex = np.arange(len(topology.vertex_uv))

    def _take_fit(self, listed: tuple[CaptureFrame, ...]) -> tuple[CaptureFrame, ...]:
        """Take over what was fitted to a published directory."""
        fitted = files.read_arrays(self.path / FITTED)
        rows = files.read_frames(self.path / multiface.EXPRESSIONS)
        known = {(each.segment, each.name): each.arkit for each in rows}
        count = len(self.topology.vertex_uv)
        self._to_ours = fitted.pop("to_ours", np.zeros(0))
        if self._to_ours.shape != (3, 4) or any(each.shape != (count,) for each in fitted.values()):
            raise CaptureError(
                f"{self.path / FITTED}: is of another mesh; run pica capture expressions again"
            )
        self.topology = self.tracked_topology = replace(self.topology, regions=fitted)
        return tuple(replace(f, arkit=known.get((f.segment, f.name))) for f in listed)

    def _usable(self, listed: tuple[CaptureFrame, ...]) -> tuple[CaptureFrame, ...]:
        problems = [self._incomplete(frame) for frame in listed]
        bad = tuple(problem for problem in problems if problem is not None)
        self.left_out += bad
        kept = [frame for frame, problem in zip(listed, problems, strict=True) if problem is None]
        if not kept:
            raise CaptureError(f"{bad[0]}; no frame of the capture is complete")
        if bad:
            log.warning(
                "%s: %d of %d frames are left out, the first because of %s",
                self.path, len(bad), len(listed), bad[0],
            )  # fmt: skip
        return tuple(kept)

    def _incomplete(self, frame: CaptureFrame) -> str | None:
        """Why a frame cannot be used, from names and sizes alone; None if it can."""
        for kind in ("tracked_mesh", "pose", "texture"):
            place = self._at(kind, frame)
            if not place.is_file():
                return f"{place}: No such file; download it, or render again"
            size = place.stat().st_size if isinstance(place, Path) else 0
            if kind == "tracked_mesh" and size and size != (wanted := 12 * self._num_mesh_vertices):
                return f"{place}: {size} bytes; {self._num_mesh_vertices} vertices need {wanted}"
        if self._is_fitted and frame.arkit is None:
            where = f"{self.path / multiface.EXPRESSIONS}: no row of {frame.segment} {frame.name}"
            return f"{where}; run pica capture expressions again"
        return None

    @classmethod
    def open(cls, path: str | Path, *, take_fit: bool = True) -> "Capture":
        """Open a capture directory and check what describes it; images and meshes are checked when
        read.

        Args:
            path: The directory: one of ours, or a Multiface or Ava-256 directory as published.
            take_fit: Whether to take over what was fitted to a published one.
        """
        root = Path(path)
        if not root.is_dir():
            raise CaptureError(f"{root}: no such directory")
        if (root / NERSEMBLE).is_file():
            raise CaptureError(
                f"{root}: films without a tracked mesh cannot be trained on; "
                f"pica capture me --photos {root} fits a head to their first pictures"
            )
        is_ours = (root / multiface.CAPTURE).is_file()
        if not is_ours and ((root / multiface.MARKER).exists() or not is_published(root)):
            raise CaptureError(
                f"{root}: no {multiface.CAPTURE}; not a capture, or one that is not finished"
            )
        return cls(root, take_fit=take_fit)

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
        return tuple(n for n in self._cameras if self._has_image(frame, n))

    def image(self, frame: CaptureFrame, camera: str) -> ByteArray:
        """sRGB image as stored, row 0 on top. uint8 ``[H, W, 3]``."""
        return self._load("images", "RGB", frame, camera)

    def depth_m(self, frame: CaptureFrame, camera: str) -> FloatArray:
        """Depth along the camera axis at pixel centres, 0 where empty. float32 ``[H, W]``."""
        units = self._load("depth", "I;16", frame, camera)
        return units.astype(np.float32) * np.float32(multiface.DEPTH_UNIT_M)

    def mask(self, frame: CaptureFrame, camera: str) -> BoolArray:
        """Which pixels of an image show the person; all where nothing says. bool ``[H, W]``."""
        view, place = self.camera(camera), self._at("mask", frame, camera)
        shape = (view.height, view.width)
        if not place.is_file():
            return np.ones(shape, np.bool_)
        part = files.load_image(place, "P", None)
        row, column = (np.arange(n) * of // n for n, of in zip(shape, part.shape, strict=True))
        return ~np.isin(part[row[:, None], column], ava.NO_PERSON)

    def _load(self, kind: str, mode: str, frame: CaptureFrame, camera: str) -> Array:
        view = self.camera(camera)
        return files.load_image(self._at(kind, frame, camera), mode, (view.width, view.height))

    def vertices_m(self, frame: CaptureFrame) -> FloatArray:
        """Tracked mesh on `tracked_topology`, head frame, metres. float32 ``[Vt, 3]``."""
        place = self._at("tracked_mesh", frame)
        found = files.read_vertices(place, self._num_mesh_vertices)[self._mesh_vertex]
        if not self._is_fitted:
            return found
        return (found @ self._to_ours[:, :3].T + self._to_ours[:, 3]).astype(np.float32)

    def true_vertices_m(self, frame: CaptureFrame) -> FloatArray:
        """Exact mesh on `topology`, head frame, metres. float32 ``[V, 3]``."""
        return files.read_vertices(self._at("truth_mesh", frame), len(self.topology.vertex_uv))

    def head_to_world(self, frame: CaptureFrame) -> Float64Array:
        """Rotation and translation (metres) from head frame to world. float64 ``[3, 4]``."""
        pose = files.read_transform(self._at("pose", frame))
        turn = pose[:, :3] @ self._to_ours[:, :3].T
        return np.column_stack([turn, pose[:, 3] - turn @ self._to_ours[:, 3]])

    def head_camera(self, frame: CaptureFrame, name: str) -> Camera:
        """A camera in the frame's head axes: it projects the frame's meshes as they are."""
        return self.camera(name).in_head(self.head_to_world(frame))

    def average_texture(self, frame: CaptureFrame) -> ByteArray:
        """Average texture, row 0 is v = 0, black where no camera looked. uint8 ``[S, S, 3]``."""
        size = (self.texture_size, self.texture_size)
        stored = files.load_image(self._at("texture", frame), "RGB", size)
        return np.ascontiguousarray(stored[::-1])  # files have it upside down
