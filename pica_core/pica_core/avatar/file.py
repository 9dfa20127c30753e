"""The avatar file (``.pica``): weights and tables of one person, and a manifest about them.

The file is plain safetensors; the manifest is JSON in its metadata. It holds numbers only: no
graph, no shader, no pickle. A reader rebuilds graphs and shaders from `AvatarSpec`, so a
stranger's file can look ugly but cannot run. Everything is checked here, once; code behind
`load_avatar` trusts what it gets.

Tensors, float32 in memory unless stated:

    {decoder layers}      as `decoder_layers(spec, "geometry" | "expression")` names and shapes them
    geometry.mean         [S, S, 3] metres, head frame:
                          position map = mean + position_scale_m * decoded geometry
    linear.*              in its place where the spec says `bases` (`linear`)
    uv_encoding           [T, T, 4], row 0 is v = 0
    u_encoding v_encoding [L, 2]; each of the three as the spec's encoding has it
    xyz.{i}.weight .bias  [out, in], [out]: SIREN over head-frame xyz in *metres*
    pixel.{i}.weight .bias    [out, in], [out]: the pixel decoder
    mesh.vertex_uv        [V, 2] in [0, 1]
    mesh.faces            [F, 3] int32, counter-clockwise seen from outside
    encoder.{i}.weight .bias  [out, in], [out]: 52 ARKit values to a latent, LeakyReLU between
    level.*               levels of detail (`levels`); may be absent
    static.parts          which vertices do not change with the face (`levels`); may be absent

In the file big maps may be smaller than in memory: see `storage`.
"""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import safetensors
import safetensors.numpy

from pica_core.avatar.levels import (
    EXIT_SIZES,
    STATIC_NAME,
    STILL_NAME,
    decoded_faces,
    faces_name,
    is_faces,
    is_index,
    level_shapes,
    parts_of,
    sheet_rows,
    static_shape,
    textured_faces,
)
from pica_core.avatar.levels import PREFIX as LEVEL_PREFIX
from pica_core.avatar.linear import check_linear, latent_movements, linear_shapes, stretches
from pica_core.avatar.manifest import Manifest
from pica_core.avatar.spec import MAP_SIZE, AvatarSpec, spec_tensor_shapes
from pica_core.avatar.storage import MAX_MAGNITUDE, to_memory, to_storage
from pica_core.errors import AvatarFileError
from pica_core.files import replacing
from pica_core.sampling import sample_vertices
from pica_core.types import MAX_LATENT_LENGTH, Array, FloatArray, IntArray

MAX_FILE_BYTES = 64 * 2**20
MAX_HEADER_BYTES = 256 * 2**10
MAX_VERTICES = 200_000
MAX_FACES = 400_000
MAX_COVER_M2 = 4.0
"""A level's triangles together, at rest (measured: 0.4 to 0.8 for the six that ship): hundreds of
thousands across a face would stop every viewer."""
MAX_MOVED_COVER_M2 = 600.0
"""The same, moved by bases, over all latents that a receiver lets through (measured by this upper
bound: 50 to 76; chosen: 6,000 took 0.4 s an image)."""

_WEIGHT_TYPES = {"F32", "F16", "U8", "U16"}


@dataclass(frozen=True, slots=True, eq=False)
class Avatar:
    """A checked avatar. Arrays are read-only.

    What takes a level raises ValueError where the avatar does not have it.
    """

    manifest: Manifest
    tensors: Mapping[str, Array]
    levels: tuple[int, ...] = field(init=False)
    """Map sizes that it can be decoded to, ascending; ends with `MAP_SIZE`."""

    def __post_init__(self) -> None:
        levels = (*EXIT_SIZES, MAP_SIZE) if STILL_NAME in self.tensors else (MAP_SIZE,)
        object.__setattr__(self, "levels", levels)  # asked for many times a frame

    @property
    def spec(self) -> AvatarSpec:
        """Sizes of the model."""
        return self.manifest.spec

    def level_faces(self, level: int) -> IntArray:
        """Triangles to draw at a level, int32 ``[F, 3]``."""
        if level not in self.levels:
            known = ", ".join(map(str, self.levels))
            raise ValueError(f"level is {level}; this avatar has {known}")
        name = "mesh.faces" if level == MAP_SIZE else faces_name(level)
        return self.tensors[name]

    def decoded_faces(self, level: int) -> IntArray:
        """Those of `level_faces` whose pixels are decoded, int32 ``[F, 3]``."""
        return decoded_faces(self.level_faces(level), parts_of(self.tensors))

    def textured_faces(self, level: int) -> IntArray:
        """Those of `level_faces` that have a texture, int32 ``[F, 3]``; may be none."""
        return textured_faces(self.level_faces(level), parts_of(self.tensors))

    def position_rows(self, level: int) -> int:
        """Rows of the position map, or of the sheet of a level's vertices where bases make them;
        both have as many columns as the level has texels."""
        used = self.sheet_vertices(level)
        return level if used is None else sheet_rows(len(used), level)

    @property
    def mean_vertices_m(self) -> FloatArray:
        """The mesh at rest, float32 ``[V, 3]``."""
        uv = self.tensors["mesh.vertex_uv"]
        if self.spec.geometry == "bases":
            return self.tensors["linear.mean"].reshape(-1, 3)[: len(uv)]
        return sample_vertices(self.tensors["geometry.mean"], uv)

    def sheet_vertices(self, level: int) -> IntArray | None:
        """The vertices whose positions a decode at a level makes, by their numbers, in the order
        of its sheet; None where it makes a map."""
        faces = self.level_faces(level)
        if self.spec.geometry != "bases":
            return None
        if level == MAP_SIZE:
            return np.arange(len(self.tensors["mesh.vertex_uv"]), dtype=np.int32)
        return np.unique(faces)

    def sheet_places(self, level: int) -> IntArray:
        """The vertex at each place of a sheet that bases make; the last one fills its last row."""
        used = self.sheet_vertices(level)
        assert used is not None  # of bases
        if level == MAP_SIZE:  # what fills it stands in the file
            return np.arange(self.position_rows(level) * level, dtype=np.int32)
        places: IntArray = np.full(self.position_rows(level) * level, used[-1], np.int32)
        places[: len(used)] = used
        return places

    def vertices_of(self, position_map: FloatArray, level: int) -> FloatArray:
        """The vertices that a decode at a level made, ``[V, 3]``: all of the mesh, or those of
        `sheet_vertices`."""
        used = self.sheet_vertices(level)
        if used is None:
            return sample_vertices(position_map, self.tensors["mesh.vertex_uv"])
        return position_map.reshape(-1, 3)[: len(used)]


def avatar_id(source: Path | str | bytes) -> str:
    """The identity of an avatar file: SHA-256 of its bytes, hexadecimal.

    Raises:
        AvatarFileError: The file cannot be read or is larger than any avatar.
    """
    return hashlib.sha256(_content(source)).hexdigest()


def save_avatar(path: Path | str, avatar: Avatar) -> None:
    """Write an avatar file, after the same checks as when one is read.

    Args:
        path: Replaced if it exists.

    Raises:
        AvatarFileError: The avatar is not one that `load_avatar` would accept, or the file cannot
            be written.
    """
    # Row after row: safetensors writes the memory of an array as it lies there.
    tensors = {name: np.ascontiguousarray(array) for name, array in avatar.tensors.items()}
    with _naming(path):
        _check_tensors(avatar.spec, tensors)
    stored: dict[str, Array] = {}
    affine: dict[str, Any] = {}
    for name, array in tensors.items():
        num_vertices = len(tensors["mesh.vertex_uv"])
        small, table = to_storage(name, array, num_vertices)
        stored[name] = np.ascontiguousarray(small)
        if table is not None:
            affine[name] = table
    metadata = {
        "pica": json.dumps(avatar.manifest.to_json(), allow_nan=False),
        "storage": json.dumps(affine, allow_nan=False),
    }
    data = _with_ordered_metadata(safetensors.numpy.save(stored, metadata))
    load_avatar(data, str(path))  # what we write, we must be able to read; checks the manifest, too
    try:
        with replacing(Path(path)) as unfinished:
            unfinished.write_bytes(data)
    except OSError as error:
        raise AvatarFileError(f"{path}: cannot be written: {error.strerror or error}") from error


def load_avatar(source: Path | str | bytes, name: str | None = None) -> Avatar:
    """Read and check an avatar.

    Args:
        source: A file, or its content.
        name: What to call it in messages; the path by default.

    Raises:
        AvatarFileError: Missing, too large, not safetensors, or anything in it differs from what
            its spec asks for. The message names file, field and limit.
    """
    data = _content(source)
    with _naming(name or ("avatar" if isinstance(source, bytes) else source)):
        header = _read_header(data)
        metadata = header.pop("__metadata__", None)
        if not isinstance(metadata, dict) or "pica" not in metadata:
            raise ValueError("metadata has no 'pica' manifest; this is not an avatar file")
        manifest = Manifest.from_json(_parse_json("manifest", metadata["pica"]))
        affine = _parse_json("storage", metadata.get("storage", "{}"))
        _check_header(manifest.spec, header)
        try:
            stored = safetensors.numpy.load(data)
        except (safetensors.SafetensorError, ValueError, KeyError) as error:
            raise ValueError(
                f"cut or damaged, not valid safetensors ({error}); get the file again"
            ) from error
        tensors = {key: to_memory(key, stored[key], affine) for key in sorted(header)}
        _check_tensors(manifest.spec, tensors)
        for array in tensors.values():
            array.flags.writeable = False
        avatar = Avatar(manifest, MappingProxyType(tensors))
        _check_cover(avatar)
    return avatar


@contextmanager
def _naming(where: Path | str) -> Iterator[None]:
    """Turn each ValueError about a file's content into an AvatarFileError that names the file."""
    try:
        yield
    except ValueError as error:
        raise AvatarFileError(f"{where}: {error}") from error


def read_bytes(path: Path | str, limit: int) -> bytes:
    """The content of a file; AvatarFileError if it cannot be read, or is larger than a limit."""
    try:
        with Path(path).open("rb") as file:
            data = file.read(limit + 1)
    except OSError as error:
        raise AvatarFileError(f"{path}: cannot be read: {error.strerror or error}") from error
    if len(data) > limit:
        raise AvatarFileError(f"{path}: file is larger than {limit} bytes, the limit")
    return data


def _content(source: Path | str | bytes) -> bytes:
    return source if isinstance(source, bytes) else read_bytes(source, MAX_FILE_BYTES)


def _read_header(data: bytes) -> dict[str, Any]:
    if not 8 <= len(data) <= MAX_FILE_BYTES:
        raise ValueError(f"{len(data)} bytes; an avatar file has 8 to {MAX_FILE_BYTES}")
    length = int.from_bytes(data[:8], "little")
    if length > MAX_HEADER_BYTES:
        raise ValueError(
            f"header of {length} bytes (the limit is {MAX_HEADER_BYTES}); "
            "this is not an avatar file"
        )
    if 8 + length > len(data):
        raise ValueError(
            f"cut: the header alone needs {8 + length} bytes, {len(data)} are there; "
            "get the file again"
        )
    header = _parse_json("header", data[8 : 8 + length])
    if not isinstance(header, dict):
        raise ValueError("header is not a JSON object; this is not an avatar file")
    return header


def _parse_json(field: str, text: object) -> Any:
    def refuse_constant(constant: str) -> None:
        raise ValueError(f"the constant {constant} is not allowed")

    def refuse_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) != len(pairs):  # two readers could see two different files
            raise ValueError("a key appears twice")
        return found

    if not isinstance(text, str | bytes):
        raise ValueError(f"{field} is {type(text).__name__}; JSON text is needed")
    try:
        return json.loads(text, parse_constant=refuse_constant, object_pairs_hook=refuse_duplicates)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{field} is not valid JSON: {error}") from error


def _check_header(spec: AvatarSpec, header: Mapping[str, Any]) -> None:
    """Check names, shapes and stored types of all tensors, before any of them is materialised."""
    shapes: dict[str, tuple[int, ...]] = {}
    for name, entry in header.items():
        shape = entry.get("shape") if isinstance(entry, dict) else None
        if not isinstance(shape, list) or not all(type(n) is int and n > 0 for n in shape):
            raise ValueError(f"tensor {name!r:.80} has no proper shape")
        shapes[name] = tuple(shape)
    _check_shapes(spec, shapes)
    for name, entry in header.items():
        allowed = {"I32", "U16"} if is_index(name) else _WEIGHT_TYPES
        if name == STATIC_NAME:
            allowed = {"U8"}
        if (stored := str(entry.get("dtype"))) not in allowed:
            raise ValueError(
                f"tensor {name} is stored as {stored:.20}; allowed are {', '.join(sorted(allowed))}"
            )


def _check_shapes(spec: AvatarSpec, shapes: Mapping[str, tuple[int, ...]]) -> None:
    wanted = spec_tensor_shapes(spec)
    for name, columns, limit in (("mesh.vertex_uv", 2, MAX_VERTICES), ("mesh.faces", 3, MAX_FACES)):
        rows = (*shapes.get(name, ()), 0)[0]
        if rows > limit:
            raise ValueError(f"tensor {name} has {rows} rows; the limit is {limit}")
        wanted[name] = (rows, columns)
    is_static = STATIC_NAME in shapes
    if is_static:
        wanted[STATIC_NAME] = static_shape(wanted["mesh.vertex_uv"][0])
    has_levels = any(name.startswith(LEVEL_PREFIX) for name in shapes)
    if spec.geometry == "bases" and (has_levels or is_static):
        wanted |= level_shapes(shapes, MAX_FACES)
    if spec.geometry == "bases":
        wanted |= linear_shapes(shapes, wanted["mesh.vertex_uv"][0])
    if missing := sorted(wanted.keys() - shapes):
        raise ValueError(f"tensor {missing[0]} is missing ({len(missing)} in total)")
    if unknown := sorted(shapes.keys() - wanted):
        raise ValueError(f"tensor {unknown[0]!r:.80} is unknown")
    for name, shape in wanted.items():
        if shapes[name] != shape:
            raise ValueError(
                f"tensor {name} has shape {list(shapes[name])}; {list(shape)} is needed"
            )


def _check_tensors(spec: AvatarSpec, tensors: Mapping[str, Array]) -> None:
    _check_shapes(spec, {name: array.shape for name, array in tensors.items()})
    own = dict(tensors)
    parts = own.pop(STATIC_NAME, np.zeros(0, np.uint8))
    if parts.dtype != np.uint8:
        raise ValueError(f"tensor {STATIC_NAME} is {parts.dtype}; uint8 is needed")
    for name, array in own.items():
        wanted = np.int32 if is_index(name) else np.float32
        if array.dtype != wanted:
            raise ValueError(f"tensor {name} is {array.dtype}; {np.dtype(wanted)} is needed")
        is_within = array.min() >= -MAX_MAGNITUDE and array.max() <= MAX_MAGNITUDE  # so no NaN
        if not is_index(name) and not is_within:
            raise ValueError(
                f"tensor {name} has values that are not finite or beyond {MAX_MAGNITUDE:g}"
            )
    uv = tensors["mesh.vertex_uv"]
    if uv.min() < 0 or uv.max() > 1:
        raise ValueError(
            f"tensor mesh.vertex_uv spans {uv.min():g} to {uv.max():g}; 0 to 1 is allowed"
        )
    for name in filter(is_faces, tensors):
        low, high = tensors[name].min(), tensors[name].max()
        if low < 0 or high >= len(uv):
            raise ValueError(
                f"tensor {name} names vertices {low} to {high}; allowed are 0 to {len(uv) - 1}"
            )
        if not len(decoded_faces(tensors[name], parts_of(tensors))):
            raise ValueError(f"tensor {STATIC_NAME} leaves 0 triangles of {name}; 1 is the least")
    if spec.geometry == "bases":
        check_linear(tensors)


@np.errstate(over="ignore", invalid="ignore")  # what is no number is beyond the limit
def _check_cover(avatar: Avatar) -> None:
    """Refuse triangles that lie over one another without end, at rest or when they move."""
    rest_m, moved = avatar.mean_vertices_m, None
    if avatar.spec.geometry == "bases":
        moved = latent_movements(avatar.tensors, avatar.manifest.position_scale_m)
    for level in avatar.levels:
        faces = avatar.level_faces(level)
        a, b, c = rest_m[faces].transpose(1, 0, 2)
        area_m2 = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        checks = [("", area_m2, MAX_COVER_M2)]
        if moved is not None:
            lengths_m = np.linalg.norm([b - a, c - a], axis=2)
            lengths_m += MAX_LATENT_LENGTH * stretches(moved, faces)
            checks.append((" may, moved by linear.*,", lengths_m.prod(0), MAX_MOVED_COVER_M2))
        for how, twice_m2, limit in checks:
            cover_m2 = float(twice_m2.sum(dtype=np.float64)) / 2
            if not cover_m2 <= limit:
                raise ValueError(
                    f"triangles of level {level}{how} cover {cover_m2:.1f} m^2; "
                    f"the limit is {limit:g}"
                )


def _with_ordered_metadata(data: bytes) -> bytes:
    """The same file with its metadata in alphabetical order.

    safetensors leaves that order to chance, and then one avatar would have two identities.
    """
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)  # as the format wants it: tensors begin at a multiple of 8
    return len(text).to_bytes(8, "little") + text + data[8 + length :]


SUFFIX: Final = ".pica"


def shipped_avatar_files() -> list[Path]:
    """The avatar files inside the package, by name."""
    folder = resources.files("pica_core") / "avatars"
    if not folder.is_dir():
        return []
    return sorted(Path(str(item)) for item in folder.iterdir() if item.name.endswith(SUFFIX))


def shipped_portraits() -> dict[str, Path]:
    """The PNG files that show the shipped avatars at rest, by the avatars' names."""
    pictures = {file.stem: file.with_suffix(".png") for file in shipped_avatar_files()}
    return {name: picture for name, picture in pictures.items() if picture.is_file()}


def avatar_file(named: Path) -> Path:
    """The file that a name means: itself, or that of an avatar that ships.

    Raises:
        AvatarFileError: It is neither a file's name nor that of a shipped avatar.
    """
    if named.suffix == SUFFIX or named.is_file():
        return Path(os.path.expanduser(named))
    shipped = {path.stem: path for path in shipped_avatar_files()}
    if (name := str(named).lower()) not in shipped:
        known = ", ".join(shipped) or "none"
        raise AvatarFileError(
            f"avatar {str(named)!r} is unknown; shipped are: {known}; or give a {SUFFIX} file"
        )
    return shipped[name]
