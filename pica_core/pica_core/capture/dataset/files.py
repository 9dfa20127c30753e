"""Single files of a capture as arrays.

What is missing, damaged or does not fit is a `CaptureError` that names the file.
"""

import csv
import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from pica_core.avatar.arkit import ARKIT_NAMES, NUM_ARKIT
from pica_core.capture.dataset import multiface
from pica_core.errors import CaptureError
from pica_core.types import Array, BoolArray, Float64Array, FloatArray, Int64Array, IntArray

SPLITS = ("train", "test")
MAP_SIZE = 256
"""Texels along each side of the position map that charts are made for."""
MAX_FILE_BYTES = 1 << 30
"""Larger files are refused before reading."""
MAX_IMAGE_PIXELS = 64_000_000
"""Larger images are refused before decoding."""
IMAGE_FORMATS = ("PNG", "JPEG", "WEBP")
"""What images may be, whatever their names say: other decoders of Pillow run programs."""
MAX_LENGTH_M = 100.0
"""Nothing of a capture is farther away."""
MAX_EXPRESSION = 100.0
"""Larger expression values are refused."""
MAX_VERTICES = 4_000_000
"""Larger meshes are refused."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CaptureFrame:
    """One moment of a capture."""

    index: int
    """Place in `Capture.frames`."""
    listed: int
    """Place in the capture's list, of which `Capture.frames` leaves out what cannot be used."""
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
        regions: Named vertex sets (`coordinates.name_regions`). bool ``[V]`` each.
    """

    vertex_uv: FloatArray
    faces: IntArray
    regions: dict[str, BoolArray]

    def region(self, name: str) -> BoolArray:
        """A vertex set by name; empty where there is none."""
        return self.regions.get(name, np.zeros(len(self.vertex_uv), np.bool_))

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


def read_bytes(path: Path) -> bytes:
    """Read a whole file of at most `MAX_FILE_BYTES`."""
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise CaptureError(f"{path}: {size} bytes; at most {MAX_FILE_BYTES} are allowed")
        return path.read_bytes()
    except FileNotFoundError:
        raise CaptureError(f"{path}: the file is missing") from None
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read ({error.strerror})") from error


def load_image(path: Path, mode: str, size: tuple[int, int] | None) -> Array:
    """Decode an image.

    Args:
        mode: ``RGB``, or ``I;16`` for 16 bit.
        size: Columns and rows that it must have; None takes any.
    """
    with _opened(path, mode, size) as image:
        if mode == "I;16":
            return np.asarray(image).astype(np.uint16)
        return np.asarray(image.convert(mode))


def check_image_header(path: Path, mode: str, size: tuple[int, int] | None) -> tuple[int, int]:
    """Check what an image's first bytes say, and that a PNG is whole; returns columns and rows."""
    with _opened(path, mode, size) as image:
        if image.format == "PNG":
            with path.open("rb") as file:
                file.seek(-12, io.SEEK_END)
                if file.read(8)[4:] != b"IEND":
                    raise ValueError("it ends early")
        return image.size


@contextmanager
def _opened(path: Path, mode: str, size: tuple[int, int] | None) -> Iterator[Image.Image]:
    """An image of the wanted kind and size, whose pixels are not decoded yet."""
    try:
        with Image.open(path, formats=IMAGE_FORMATS) as image:
            if image.width * image.height > MAX_IMAGE_PIXELS:
                raise CaptureError(f"{path}: {image.width}x{image.height} pixels are too many")
            if size is not None and image.size != size:
                raise CaptureError(
                    f"{path}: the image is {image.width}x{image.height}, {size[0]}x{size[1]} is "
                    "needed"
                )
            if mode == "I;16" and not image.mode.startswith("I"):
                raise CaptureError(f"{path}: a 16-bit image is needed, found {image.mode}")
            yield image
    except FileNotFoundError:
        raise CaptureError(f"{path}: the file is missing") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise CaptureError(f"{path}: not a complete image ({error})") from error


def read_vertices(path: Path, count: int) -> FloatArray:
    """A mesh file of `count` vertices, in metres. float32 ``[count, 3]``."""
    wanted = 12 * count
    data = read_bytes(path)
    if len(data) != wanted:
        raise CaptureError(f"{path}: {len(data)} bytes; {count} vertices need {wanted} (float32)")
    vertices = np.frombuffer(data, "<f4").reshape(-1, 3) / np.float32(multiface.MILLIMETRES)
    if not np.isfinite(vertices).all():
        raise CaptureError(f"{path}: vertices are not all finite")
    far = float(np.abs(vertices).max())
    if far > MAX_LENGTH_M:
        raise CaptureError(f"{path}: a vertex at {far:.3g} m; at most {MAX_LENGTH_M:g} is allowed")
    return vertices.astype(np.float32)


def read_transform(path: Path) -> Float64Array:
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
    if far > MAX_LENGTH_M:
        raise CaptureError(f"{path}: {far:.3g} in the pose; at most {MAX_LENGTH_M:g} is allowed")
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


def read_topology(path: Path) -> Topology:
    """Read a topology and check that its fields fit each other."""
    arrays = read_arrays(path)
    for name in ("vertex_uv", "faces"):
        if name not in arrays:
            raise CaptureError(f"{path}: field {name!r} is missing")
    uv, faces = arrays["vertex_uv"], arrays["faces"]
    if uv.ndim != 2 or uv.shape[1] != 2 or uv.dtype.kind != "f" or not np.isfinite(uv).all():
        raise CaptureError(f"{path}: field 'vertex_uv' is {uv.shape}; finite [V, 2] is needed")
    if not 0 < len(uv) <= MAX_VERTICES:
        raise CaptureError(f"{path}: {len(uv)} vertices; allowed are 1 to {MAX_VERTICES}")
    if (
        faces.ndim != 2 or faces.shape[1] != 3 or not len(faces) or faces.dtype.kind not in "iu"
        or faces.min() < 0 or faces.max() >= len(uv)
    ):  # fmt: skip
        raise CaptureError(
            f"{path}: field 'faces' is {faces.shape} or points outside {len(uv)} vertices"
        )
    regions = {}
    for name, value in arrays.items():
        if name.startswith("region_"):
            if value.shape != (len(uv),):
                raise CaptureError(f"{path}: {name!r} is {value.shape}; [{len(uv)}] is needed")
            regions[name.removeprefix("region_")] = value.astype(np.bool_)
    return Topology(vertex_uv=uv.astype(np.float32), faces=faces.astype(np.int32), regions=regions)


def read_tracked(root: Path, num_dense: int) -> tuple[Topology, Int64Array]:
    """The tracked mesh of a synthetic capture, and which of `num_dense` vertices each of its is."""
    path = root / multiface.TRACKED_TOPOLOGY
    topology = read_topology(path)
    index = read_arrays(path).get("dense_vertex", np.zeros(0))
    is_index = index.shape == (len(topology.vertex_uv),) and index.dtype.kind == "i"
    if not is_index or index.min() < 0 or index.max() >= num_dense:
        raise CaptureError(f"{path}: field 'dense_vertex' is no index for each vertex")
    return topology, index.astype(np.int64)


def read_frame_list(path: Path) -> list[tuple[str, str]]:
    """Segment and frame of every line."""
    names = []
    for number, line in enumerate(multiface.read_text(path).splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        if len(words) != 2 or any("/" in word or word.startswith(".") for word in words):
            raise CaptureError(f"{path}:{number}: {line!r:.80} is not SEGMENT FRAME")
        names.append((words[0], words[1]))
    if not names:
        raise CaptureError(f"{path}: no frames")
    if len(set(names)) < len(names):
        twice = next(name for at, name in enumerate(names) if name in names[:at])
        raise CaptureError(f"{path}: {' '.join(twice)} is listed twice")
    return names


def read_expressions(path: Path) -> dict[tuple[str, str], tuple[str, list[float]]]:
    """Split and 52 values by segment and frame."""
    try:
        rows = list(csv.reader(io.StringIO(multiface.read_text(path))))
    except csv.Error as error:
        raise CaptureError(f"{path}: not a table ({error})") from error
    header = rows[0] if rows else []
    missing = [name for name in ("segment", "frame", "split", *ARKIT_NAMES) if name not in header]
    if missing:
        raise CaptureError(f"{path}: column {missing[0]!r} is missing")
    place = [header.index(name) for name in ARKIT_NAMES]
    table: dict[tuple[str, str], tuple[str, list[float]]] = {}
    for number, row in enumerate(rows[1:], start=2):
        try:
            values = [float(row[at]) for at in place]
            split = row[header.index("split")]
            key = (row[header.index("segment")], row[header.index("frame")])
        except (IndexError, ValueError) as error:
            raise CaptureError(f"{path}:{number}: row cannot be read ({error})") from error
        if split not in SPLITS:
            raise CaptureError(f"{path}:{number}: split is {split!r:.40}; train or test is needed")
        if not np.isfinite(values).all() or np.abs(values).max() > MAX_EXPRESSION:
            raise CaptureError(f"{path}:{number}: a value is not finite or beyond {MAX_EXPRESSION}")
        table[key] = (split, values)
    return table


def read_frames(root: Path) -> tuple[tuple[CaptureFrame, ...], FloatArray]:
    """The frames of a capture with expressions, in the order of the list."""
    table = read_expressions(root / multiface.EXPRESSIONS)
    list_path = root / multiface.FRAME_LIST
    frames: list[CaptureFrame] = []
    arkit: list[list[float]] = []
    for segment, name in read_frame_list(list_path):
        if (segment, name) not in table:
            raise CaptureError(
                f"{list_path}: {segment} {name} has no row in {multiface.EXPRESSIONS}"
            )
        split, values = table[segment, name]
        place = len(frames)
        frames.append(
            CaptureFrame(index=place, listed=place, segment=segment, name=name, split=split)
        )
        arkit.append(values)
    return tuple(frames), np.array(arkit, np.float32).reshape(-1, NUM_ARKIT)
