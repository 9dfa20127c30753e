"""Single files of a capture as arrays.

What is missing, damaged or does not fit is a `CaptureError` that names the file.
"""

import csv
import io
import json
from collections.abc import Callable, Container, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from pica_core.avatar.arkit import ARKIT_NAMES
from pica_core.capture.dataset import multiface
from pica_core.capture.dataset.members import Member
from pica_core.errors import CaptureError
from pica_core.types import Array, BoolArray, Float64Array, FloatArray, Int64Array, IntArray

SPLITS = ("train", "test")
MAX_IMAGE_PIXELS = 64_000_000
"""Larger images are refused before decoding."""
IMAGE_FORMATS = ("PNG", "JPEG", "WEBP", "AVIF")
"""What images may be, whatever their names say: other decoders of Pillow run programs."""
HEAD_SIZE_M = (0.05, 4.0)
"""Longest sides of a mesh's bounding box that are believed: else units are wrong."""
MAX_LENGTH_M = 100.0
"""No head is farther away."""
MAX_EXPRESSION = 100.0
"""Larger expression values are refused."""
MAX_VERTICES = 4_000_000
"""Larger meshes are refused."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CaptureFrame:
    """One moment of a capture."""

    segment: str
    """Take that the frame belongs to."""
    name: str
    """Frame name within its take."""
    split: str
    """``train`` or ``test``."""
    arkit: FloatArray | None = None
    """Its shapes in `ARKIT_NAMES` order, float32 ``[52]``; None where a capture has none."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Topology:
    """What all meshes of a capture share.

    Attributes:
        vertex_uv: Texture coordinates, v = 0 is row 0. float32 ``[V, 2]``.
        faces: Triangles, counter-clockwise from outside. int32 ``[F, 3]``.
        regions: Named vertex sets (`coordinates.name_regions`). bool ``[V]`` each.
    """

    vertex_uv: FloatArray
    faces: IntArray
    regions: dict[str, BoolArray]

    def region(self, name: str) -> BoolArray:
        """A vertex set by name; empty where there is none."""
        return self.regions.get(name, np.zeros(len(self.vertex_uv), np.bool_))

    def part(self, index: Int64Array, faces: IntArray) -> "Topology":
        """The mesh of some of the vertices ``[n]``, with triangles in these."""
        regions = {name: mask[index] for name, mask in self.regions.items()}
        return Topology(vertex_uv=self.vertex_uv[index], faces=faces, regions=regions)

    def by_region(self, values: dict[str, float], elsewhere: float) -> Float64Array:
        """A number for each vertex; the last region that applies counts. ``[V]``."""
        result = np.full(len(self.vertex_uv), elsewhere)
        for name, value in values.items():
            result[self.region(name)] = value
        return result


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Take:
    """One uninterrupted performance that is to be captured.

    Attributes:
        segment: Name, unique within a capture.
        arkit: Values of the captured moments. float32 ``[T, 52]``.
        split: ``train`` or ``test``.
    """

    segment: str
    arkit: FloatArray
    split: str


def load_image(path: Path | Member, mode: str, size: tuple[int, int] | None) -> Array:
    """Decode an image.

    Args:
        mode: ``RGB``, ``I;16`` for 16 bit, or ``P`` for 8 bit as they are.
        size: Columns and rows that it must have; None takes any.
    """
    try:
        data = io.BytesIO(multiface.read_bytes(path))
        with Image.open(data, formats=IMAGE_FORMATS) as image:
            if image.width * image.height > MAX_IMAGE_PIXELS:
                raise CaptureError(f"{path}: {image.width}x{image.height} pixels are too many")
            if size is not None and image.size != size:
                raise CaptureError(
                    f"{path}: the image is {image.width}x{image.height}, {size[0]}x{size[1]} is "
                    "needed"
                )
            if mode == "P" and image.mode in ("L", "P"):
                return np.array(image)
            if mode == "RGB":
                return np.array(image.convert(mode))  # writable, as torch wants it
            if mode == "P" or not image.mode.startswith("I"):
                depth = "an 8-bit index" if mode == "P" else "a 16-bit"
                raise CaptureError(f"{path}: {depth} image is needed, found {image.mode}")
            return np.asarray(image).astype(np.uint16)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise CaptureError(f"{path}: not a complete image ({error})") from error


NUMBERS = {"float": "f4", "float32": "f4", "double": "f8", "float64": "f8", "uchar": "u1"}
"""What a vertex of a PLY file may have: places, normals and colours."""
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def ply_points(where: Path | Member, data: bytes) -> Float64Array:
    """The vertices of a PLY file, which come first in it. ``[V, 3]``."""
    head, _, body = data.partition(b"end_header")
    fields: list[tuple[str, str]] = []
    order, count, elements = "", 0, 0
    try:
        for line in head.decode("ascii").splitlines():
            match line.split():
                case ["format", name, _]:
                    order = ORDERS[name]
                case ["element", name, number]:
                    elements += 1
                    count = int(number) if (elements, name) == (1, "vertex") else count
                case ["property", kind, name] if elements == 1:
                    fields.append((name, order + NUMBERS[kind]))
        body = body.split(b"\n", 1)[1]
        if order:
            table: Any = np.frombuffer(body, np.dtype(fields), count)
        else:
            words = np.array(body.split()[: count * len(fields)], np.float64)
            columns = words.reshape(count, len(fields)).T
            table = {name: column for (name, _), column in zip(fields, columns, strict=True)}
        return np.stack([table[axis] for axis in "xyz"], 1).astype(np.float64)
    except (KeyError, ValueError, IndexError) as error:
        raise CaptureError(f"{where}: not a whole PLY file of vertices ({error!r})") from error


def read_vertices(path: Path | Member, count: int) -> FloatArray:
    """A mesh file of `count` vertices in mm, plain or PLY, in metres. float32 ``[count, 3]``."""
    data, wanted = multiface.read_bytes(path), 12 * count
    if data.startswith(b"ply"):
        points = ply_points(path, data)
        if len(points) != count:
            raise CaptureError(f"{path}: {len(points)} vertices; the topology has {count}")
    elif len(data) != wanted:
        raise CaptureError(f"{path}: {len(data)} bytes; {count} vertices need {wanted} (float32)")
    else:
        points = np.frombuffer(data, "<f4").reshape(-1, 3)
    vertices = points.astype(np.float32) / np.float32(multiface.MILLIMETRES)
    if not np.isfinite(vertices).all():
        raise CaptureError(f"{path}: vertices are not all finite")
    size = float(np.ptp(vertices.astype(np.float64), axis=0).max())
    if not HEAD_SIZE_M[0] <= size <= HEAD_SIZE_M[1]:
        raise CaptureError(f"{path}: the mesh is {size:.3g} m large; are its units mm?")
    return vertices


def read_transform(path: Path | Member) -> Float64Array:
    """A head pose, translation in metres. float64 ``[3, 4]``."""
    lines = [line.split() for line in multiface.read_text(path).splitlines() if line.strip()]
    try:
        matrix = np.array([[float(word) for word in line] for line in lines])
    except ValueError:
        matrix = np.zeros(0)
    if matrix.shape != (3, 4) or not np.isfinite(matrix).all():
        raise CaptureError(f"{path}: three lines of four numbers are needed")
    matrix[:, 3] /= multiface.MILLIMETRES
    far = float(np.abs(matrix).max())
    if far > MAX_LENGTH_M or not multiface.is_rotation(matrix[:, :3]):
        raise CaptureError(f"{path}: no rotation, or farther than {MAX_LENGTH_M:g} m away")
    return matrix


def read_arrays(path: Path) -> dict[str, Array]:
    """Read the arrays of an archive by name."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise CaptureError(f"{path}: the file is missing") from None
    except Exception as error:  # zipfile and zlib have error classes of their own
        raise CaptureError(f"{path}: not a complete archive ({error})") from error


def read_topology(path: Path) -> tuple[Topology, Topology, Int64Array]:
    """The mesh that is drawn, the tracked mesh, which may be the same object, and the drawn vertex
    that each tracked one is."""
    arrays = read_arrays(path)
    uv = arrays.get("vertex_uv", np.zeros(0))
    if uv.ndim != 2 or uv.shape[1] != 2 or uv.dtype.kind != "f" or not np.isfinite(uv).all():
        raise CaptureError(f"{path}: field 'vertex_uv' is {uv.shape}; finite [V, 2] is needed")
    if not 0 < len(uv) <= MAX_VERTICES:
        raise CaptureError(f"{path}: {len(uv)} vertices; allowed are 1 to {MAX_VERTICES}")

    def index(name: str, count: int, *shape: int) -> Array:
        """A field of indices below a count; -1 takes any number of rows."""
        found = arrays.get(name, np.zeros(0))
        fits = found.size > 0 and found.dtype.kind in "iu" and found.ndim == len(shape)
        if not fits or found.shape[1:] != shape[1:] or found.min() < 0 or found.max() >= count:
            raise CaptureError(
                f"{path}: field {name!r} is {found.shape} or points outside {count} vertices"
            )
        return found

    regions = {}
    for name, value in arrays.items():
        if name.startswith("region_"):
            if value.shape != (len(uv),):
                raise CaptureError(f"{path}: {name!r} is {value.shape}; [{len(uv)}] is needed")
            regions[name.removeprefix("region_")] = value.astype(np.bool_)
    faces = index("faces", len(uv), -1, 3).astype(np.int32)
    topology = Topology(vertex_uv=uv.astype(np.float32), faces=faces, regions=regions)
    if "dense_vertex" not in arrays:
        return topology, topology, np.arange(len(uv))
    dense_vertex = index("dense_vertex", len(uv), -1).astype(np.int64)
    tracked_faces = index("tracked_faces", len(dense_vertex), -1, 3).astype(np.int32)
    return topology, topology.part(dense_vertex, tracked_faces), dense_vertex


def check_frame_name(where: str, segment: str, name: str, known: Container[Any]) -> None:
    """Refuse names that lead out of a capture, and frames that are there twice."""
    if any(not word or "/" in word or word.startswith(".") for word in (segment, name)):
        raise CaptureError(f"{where}: {segment!r:.40} {name!r:.40} is not SEGMENT FRAME")
    if (segment, name) in known:
        raise CaptureError(f"{where}: {segment} {name} is there twice")


def read_frames(path: Path) -> tuple[CaptureFrame, ...]:
    """The frames of a capture with expressions."""
    try:
        header, *rows = csv.reader(io.StringIO(multiface.read_text(path)))
        place = [header.index(name) for name in ("segment", "frame", "split", *ARKIT_NAMES)]
    except (csv.Error, ValueError) as error:
        raise CaptureError(f"{path}: not a table of frames ({error})") from error
    frames: dict[tuple[str, str], CaptureFrame] = {}
    for index, row in enumerate(rows):
        where = f"{path}:{index + 2}"
        try:
            segment, name, split, *numbers = [row[at] for at in place]
            values = np.array([float(number) for number in numbers])
        except (IndexError, ValueError) as error:
            raise CaptureError(f"{where}: row cannot be read ({error})") from error
        if split not in SPLITS:
            raise CaptureError(f"{where}: split is {split!r:.40}; train or test is needed")
        if not np.abs(values).max() <= MAX_EXPRESSION:
            raise CaptureError(f"{where}: a value is not finite or beyond {MAX_EXPRESSION}")
        check_frame_name(where, segment, name, frames)
        frames[segment, name] = CaptureFrame(
            segment=segment, name=name, split=split, arkit=values.astype(np.float32)
        )
    train, test = (
        {each.segment for each in frames.values() if each.split == split} for split in SPLITS
    )
    if not frames or train & test:
        what = f"segment {min(train & test)} is in both splits" if frames else "no frames"
        raise CaptureError(f"{path}: {what}")
    return tuple(frames.values())


ENCODERS = 2
"""Threads that encode images; what they call lets other threads run."""
MAX_WAITING = 64
"""Images that may wait for them; then drawing waits."""


def depth_units(depth_m: FloatArray) -> npt.NDArray[np.uint16]:
    """Depth as files hold it."""
    units = np.rint(depth_m / np.float32(multiface.DEPTH_UNIT_M))
    return np.clip(units, 0, 65535).astype(np.uint16)


class BackgroundWriter(AbstractContextManager["BackgroundWriter"]):
    """Makes images and writes them while the next ones are drawn.

    `finish` waits for everything handed over so far and raises what went wrong; the writer of the
    file that marks a frame as done calls it first.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(ENCODERS, thread_name_prefix="encode")
        self._waiting: list[Future[None]] = []

    def __exit__(self, *error: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def image(self, path: Path, make: Callable[[], Array]) -> None:
        """Write what `make` returns as a PNG file."""

        def work() -> None:
            data = io.BytesIO()
            Image.fromarray(make()).save(data, "PNG", compress_level=1)
            multiface.write_aside(path, data.getvalue())

        while len(self._waiting) >= MAX_WAITING:
            self._waiting.pop(0).result()
        self._waiting.append(self._pool.submit(work))

    def finish(self) -> None:
        """Wait for all images."""
        while self._waiting:
            self._waiting.pop(0).result()


def write_topology(path: Path, topology: Topology, tracked: IntArray, dense: Int64Array) -> None:
    """Write a topology file: with the tracked triangles, and the vertex that each of theirs is."""
    arrays: dict[str, Any] = {"vertex_uv": topology.vertex_uv, "faces": topology.faces}
    arrays |= {"dense_vertex": dense.astype(np.int32), "tracked_faces": tracked}
    arrays |= {f"region_{name}": mask for name, mask in topology.regions.items()}
    write_archive(path, **arrays)


def write_archive(path: Path, **arrays: Any) -> None:
    """Write arrays by name; zip time stamps are fixed, so the same arrays give the same bytes."""
    data = io.BytesIO()
    np.savez(data, **arrays)
    multiface.write_aside(path, data.getvalue())


def write_expressions(path: Path, frames: Sequence[CaptureFrame], values: FloatArray) -> None:
    """Write the values of frames ``[T, 52]``, as `read_frames` reads them."""
    lines = [",".join(("segment", "frame", "split", *ARKIT_NAMES))]
    for frame, arkit in zip(frames, values, strict=True):
        numbers = ",".join(f"{value:.6g}" for value in arkit)
        lines.append(f"{frame.segment},{frame.name},{frame.split},{numbers}")
    multiface.write_aside(path, ("\n".join(lines) + "\n").encode())


def write_tables(out: Path, takes: list[Take], info: dict[str, Any]) -> None:
    """Write the list of frames, their expressions, and `capture.json` as the last of all."""
    frames = [
        CaptureFrame(segment=take.segment, name=f"{index:06d}", split=take.split)
        for take in takes
        for index in range(len(take.arkit))
    ]
    values = np.concatenate([take.arkit for take in takes])
    write_expressions(out / multiface.EXPRESSIONS, frames, values)
    names = [f"{frame.segment} {frame.name}" for frame in frames]
    multiface.write_aside(out / multiface.FRAME_LIST, ("\n".join(names) + "\n").encode())
    split = {split: [take.segment for take in takes if take.split == split] for split in SPLITS}
    whole = {"schema": multiface.SCHEMA, **info, "split": split}
    multiface.write_aside(out / multiface.CAPTURE, json.dumps(whole, indent=1).encode() + b"\n")
