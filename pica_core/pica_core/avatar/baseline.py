"""A trained baseline in a file, so that what is measured of avatars can be measured of it too.

Safetensors as avatar files are: numbers and a manifest, nothing that runs. Decoder and expression
encoder are stored in fp16, positions in float32. It is a measuring instrument, not an avatar: no
stream tables, no levels, nothing that a call needs, and 35 MB at the published sizes.

Tensors: those of `BaselineSpec.tensor_shapes`, ``mesh.vertex_uv`` ``[V, 2]``, ``mesh.faces``
``[F, 3]`` int32, and ``encoder.{i}.weight .bias`` as in an avatar file.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.spec import NUM_LATENT
from pica_core.avatar.storage import MAX_MAGNITUDE
from pica_core.errors import AvatarFileError
from pica_core.reference.baseline import BaselineAvatar, BaselineSpec
from pica_core.types import Array

KEY = "pica_baseline"
MAX_FILE_BYTES = 256 * 2**20
MAX_FACES = 400_000
MAX_EXTENT_M = 10.0
_EXACT = ("mesh.bias", "mesh.vertex_uv")
"""Stored in float32: half a millimetre would be lost of a position in fp16."""


def save_baseline(path: Path | str, baseline: BaselineAvatar) -> None:
    """Write a baseline; what is written is read back and checked.

    Raises:
        AvatarFileError: It is none that `load_baseline` would accept, or cannot be written.
    """
    stored: dict[str, Array] = {
        name: np.ascontiguousarray(array, np.float32 if name in _EXACT else np.float16)
        for name, array in baseline.tensors.items()
    }
    stored["mesh.vertex_uv"] = np.ascontiguousarray(baseline.vertex_uv, np.float32)
    stored["mesh.faces"] = np.ascontiguousarray(baseline.faces, np.int32)
    manifest = {
        "schema_version": 1,
        "spec": asdict(baseline.spec),
        "bounds_min_m": baseline.bounds_min_m,
        "bounds_max_m": baseline.bounds_max_m,
    }
    data = safetensors.numpy.save(stored, {KEY: json.dumps(manifest)})
    _read(str(path), data)
    try:
        Path(path).write_bytes(data)
    except OSError as error:
        raise AvatarFileError(f"{path}: cannot be written: {error.strerror or error}") from error


def load_baseline(path: Path | str) -> BaselineAvatar:
    """Read and check a baseline; all floats become float32.

    Raises:
        AvatarFileError: Missing, too large, not safetensors, or not what its manifest asks for.
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise AvatarFileError(f"{path}: cannot be read: {error.strerror or error}") from error
    return _read(str(path), data)


def _read(where: str, data: bytes) -> BaselineAvatar:
    if len(data) > MAX_FILE_BYTES:
        raise AvatarFileError(f"{where}: larger than {MAX_FILE_BYTES} bytes, the limit")
    try:
        stored = safetensors.numpy.load(data)
        length = int.from_bytes(data[:8], "little")
        header = json.loads(data[8 : 8 + length])
        manifest = json.loads(header["__metadata__"][KEY])
        sizes = manifest["spec"]
        spec = BaselineSpec(
            num_latent=int(sizes["num_latent"]),
            num_vertices=int(sizes["num_vertices"]),
            channels=tuple(int(width) for width in sizes["channels"]),
        )
        low, high = (_corner(manifest[f"bounds_{end}_m"]) for end in ("min", "max"))
    except (safetensors.SafetensorError, ValueError, KeyError, TypeError) as error:
        raise AvatarFileError(f"{where}: not a baseline file ({error})") from error
    faces = stored.pop("mesh.faces", np.zeros((0, 3), np.int32))
    if faces.dtype != np.int32 or faces.ndim != 2 or faces.shape[1] != 3:
        raise AvatarFileError(f"{where}: tensor mesh.faces is {faces.dtype} {list(faces.shape)}")
    if not 1 <= len(faces) <= MAX_FACES:
        raise AvatarFileError(f"{where}: {len(faces)} faces; 1 to {MAX_FACES} are allowed")
    tensors = {name: array.astype(np.float32) for name, array in stored.items()}
    for name, array in tensors.items():
        # One pass: NaN fails both comparisons' negation.
        if not (array.min() >= -MAX_MAGNITUDE and array.max() <= MAX_MAGNITUDE):
            raise AvatarFileError(
                f"{where}: tensor {name} has values that are not finite or beyond {MAX_MAGNITUDE:g}"
            )
    vertex_uv = tensors.pop("mesh.vertex_uv", np.zeros((0, 2), np.float32))
    _check_encoder(where, tensors)
    known = {*spec.tensor_shapes(), *(name for name in tensors if name.startswith("encoder."))}
    if unknown := sorted(set(tensors) - known):
        raise AvatarFileError(f"{where}: tensor {unknown[0]!r:.80} is unknown")
    try:
        return BaselineAvatar(
            spec=spec,
            tensors=tensors,
            vertex_uv=vertex_uv,
            faces=faces,
            bounds_min_m=low,
            bounds_max_m=high,
        )
    except ValueError as error:
        raise AvatarFileError(f"{where}: {error}") from error


def _check_encoder(where: str, tensors: dict[str, Array]) -> None:
    """Layers that lead from 52 values to a latent, or none at all."""
    count = sum(name.startswith("encoder.") for name in tensors)
    width = NUM_ARKIT
    for index in range(count // 2):
        weight = tensors.get(f"encoder.{index}.weight", np.zeros((0, 0)))
        bias = tensors.get(f"encoder.{index}.bias", np.zeros(0))
        if weight.ndim != 2 or weight.shape[1] != width or bias.shape != weight.shape[:1]:
            raise AvatarFileError(f"{where}: tensors encoder.{index} do not fit {width} inputs")
        width = weight.shape[0]
    if count % 2 or (count and width != NUM_LATENT):
        raise AvatarFileError(f"{where}: the expression encoder ends in {width} values")


def _corner(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    if not all(abs(value) <= MAX_EXTENT_M for value in (x, y, z)):
        raise ValueError(f"bounds reach {values}; {MAX_EXTENT_M:g} m is the limit")
    return x, y, z
