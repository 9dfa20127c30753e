"""The paper's baseline as a second kind of avatar: one network makes vertices and a whole texture.

Deep Appearance Models (Lombardi et al. 2018) as later published with a face capture data set; the
decoder alone, since that is what a receiver runs and what the paper's runtime tables compare:

    view direction 3 -> 8; latent z -> z
    mesh      fully connected z -> 3V
    texture   fully connected z + 8 -> z x 4 x 4, then eight transposed convolutions 4x4, stride 2,
              to channels z, 64, 64, 32, 32, 16, 16, 3, each with an untied bias at its output size

A LeakyReLU (slope 0.2) follows every layer but the two that end in vertices and texture. At z = 256
and 7,306 vertices these are 17.4 M parameters and 755 M multiply-adds in the convolutions.

It is a measuring instrument: no stream tables, no levels, nothing that a call needs. `pica train
--variant baseline` and `pica export` make one. Its file is safetensors with a manifest, as avatar
files are, 35 MB at the published sizes: decoder and expression encoder in fp16, positions in
float32. Tensors: those of `BaselineSpec.tensor_shapes`, ``mesh.vertex_uv`` ``[V, 2]``,
``mesh.faces`` ``[F, 3]`` int32, and ``encoder.{i}.weight .bias`` as in an avatar file.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import prod
from pathlib import Path

import numpy as np
import safetensors
import safetensors.numpy

from pica_core.avatar.file import (
    MAX_FACES,
    check_shapes,
    encoder_shapes,
    naming,
    read_bytes,
    write_bytes,
)
from pica_core.avatar.manifest import MAX_EXTENT_M, read_numbers
from pica_core.avatar.spec import RGB_CHANNELS, VIEW_CHANNELS
from pica_core.avatar.storage import check_finite
from pica_core.errors import check_ranges
from pica_core.latent import NUM_LATENT
from pica_core.types import Array, FloatArray, IntArray

VIEW_FEATURES = 8
"""Values that the view direction becomes."""
FIRST_SIZE = 4
"""Rows and columns of the texture decoder's first grid."""
KEY = "pica_baseline"
MAX_FILE_BYTES = 256 * 2**20
_EXACT = ("mesh.bias", "mesh.vertex_uv")
"""Stored in float32: half a millimetre would be lost of a position in fp16."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BaselineSpec:
    """Sizes of a baseline decoder; the defaults are those that were published."""

    num_latent: int = NUM_LATENT
    """Length z of the latent; ours, flattened, by default."""
    num_vertices: int = 7306
    channels: tuple[int, ...] = (NUM_LATENT, 64, 64, 32, 32, 16, 16, RGB_CHANNELS)
    """Output channels of the transposed convolutions."""

    def __post_init__(self) -> None:
        check_ranges(self, num_latent=(1, 4096), num_vertices=(1, 200_000))
        if not 1 <= len(self.channels) <= 8 or not all(1 <= c <= 4096 for c in self.channels):
            raise ValueError(f"channels are {self.channels}; 1 to 8 layers of 1 to 4096 are needed")
        if self.channels[-1] != RGB_CHANNELS:
            raise ValueError(f"channels end in {self.channels[-1]}; colours have {RGB_CHANNELS}")

    @property
    def texture_size(self) -> int:
        """Rows and columns of the texture: 1024 by default."""
        return FIRST_SIZE << len(self.channels)

    def tensor_shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of every tensor; fully connected ones ``[out, in]``, transposed
        convolutions ``[in, out, 4, 4]``."""
        z = self.num_latent
        grid = z * FIRST_SIZE * FIRST_SIZE
        shapes: dict[str, tuple[int, ...]] = {}
        for name, inputs, outputs in (
            ("view", VIEW_CHANNELS, VIEW_FEATURES),
            ("latent", z, z),
            ("mesh", z, 3 * self.num_vertices),
            ("grid", z + VIEW_FEATURES, grid),
        ):
            shapes[f"{name}.weight"] = (outputs, inputs)
            shapes[f"{name}.bias"] = (outputs,)
        channels, size = z, FIRST_SIZE
        for index, outputs in enumerate(self.channels):
            size *= 2
            shapes[f"texture.{index}.weight"] = (channels, outputs, 4, 4)
            shapes[f"texture.{index}.bias"] = (outputs, size, size)
            channels = outputs
        return shapes

    @property
    def num_parameters(self) -> int:
        """Numbers in all tensors."""
        return sum(map(prod, self.tensor_shapes().values()))

    @property
    def multiply_adds(self) -> int:
        """Multiply-adds of one frame; biases and activations are not counted."""
        total, size = 0, FIRST_SIZE
        for name, shape in self.tensor_shapes().items():
            if len(shape) == 4:  # stride 2: four of sixteen taps meet at every output
                size *= 2
                total += 4 * shape[0] * shape[1] * size * size
            elif name.endswith(".weight"):
                total += shape[0] * shape[1]
        return total


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BaselineAvatar:
    """A baseline decoder of one person, and the mesh that its vertices belong to."""

    spec: BaselineSpec
    tensors: Mapping[str, Array]
    """As `BaselineSpec.tensor_shapes` names and shapes them, float32; a trained one has
    ``encoder.{i}.weight`` and ``.bias`` beside them, from 52 ARKit values to the latent."""
    vertex_uv: FloatArray
    """Where vertices lie in the texture, in [0, 1], row 0 is v = 0. float32 ``[V, 2]``."""
    faces: IntArray
    """int32 ``[F, 3]``, counter-clockwise seen from outside."""
    bounds_min_m: tuple[float, float, float]
    """Lower corner of all positions, head frame, metres."""
    bounds_max_m: tuple[float, float, float]
    """Upper corner of all positions, head frame, metres."""

    def __post_init__(self) -> None:
        shapes = {name: array.shape for name, array in self.tensors.items()}
        has_encoder = any(name.startswith("encoder.") for name in shapes)
        wanted = self.spec.tensor_shapes() | (encoder_shapes(shapes) if has_encoder else {})
        check_shapes(shapes, wanted)
        if self.vertex_uv.shape != (self.spec.num_vertices, 2):
            raise ValueError(f"vertex_uv is {self.vertex_uv.shape}; one row a vertex is needed")
        if self.faces.min() < 0 or self.faces.max() >= self.spec.num_vertices:
            raise ValueError("faces name vertices that are not there")


def baseline_channels(texture_size: int) -> tuple[int, ...]:
    """The published channels for a texture of another size: the last layers but one are left out.

    Args:
        texture_size: Rows and columns, texels: 1024 as published, or 32, 64, ... below.

    Raises:
        ValueError: Another size.
    """
    published = BaselineSpec().channels
    sizes = {FIRST_SIZE << count: count for count in range(3, len(published) + 1)}
    if texture_size not in sizes:
        known = ", ".join(map(str, sizes))
        raise ValueError(f"texture_size is {texture_size}; known are {known}")
    return (*published[: sizes[texture_size] - 1], RGB_CHANNELS)


def save_baseline(path: Path | str, baseline: BaselineAvatar) -> None:
    """Write a baseline; what is written is read back and checked.

    Raises:
        AvatarFileError: It is none that `load_baseline` would accept, or cannot be written.
    """
    tensors = {**baseline.tensors, "mesh.vertex_uv": baseline.vertex_uv}
    stored: dict[str, Array] = {
        name: np.ascontiguousarray(array, np.float32 if name in _EXACT else np.float16)
        for name, array in tensors.items()
    }
    stored["mesh.faces"] = np.ascontiguousarray(baseline.faces, np.int32)
    manifest = {
        "schema_version": 1,
        "spec": asdict(baseline.spec),
        "bounds_min_m": baseline.bounds_min_m,
        "bounds_max_m": baseline.bounds_max_m,
    }
    data = safetensors.numpy.save(stored, {KEY: json.dumps(manifest)})
    with naming(path):
        _parse(data)
    write_bytes(path, data)


def load_baseline(path: Path | str) -> BaselineAvatar:
    """Read and check a baseline; all floats become float32.

    Raises:
        AvatarFileError: Missing, too large, not safetensors, or not what its manifest asks for.
    """
    data = read_bytes(path, MAX_FILE_BYTES)
    with naming(path):
        return _parse(data)


def _parse(data: bytes) -> BaselineAvatar:
    try:
        stored = safetensors.numpy.load(data)
        length = int.from_bytes(data[:8], "little")
        manifest = json.loads(json.loads(data[8 : 8 + length])["__metadata__"][KEY])
        sizes = manifest["spec"]
        spec = BaselineSpec(
            num_latent=int(sizes["num_latent"]),
            num_vertices=int(sizes["num_vertices"]),
            channels=tuple(int(width) for width in sizes["channels"]),
        )
        low, high = (
            read_numbers(manifest, f"bounds_{end}_m", 3, -MAX_EXTENT_M, MAX_EXTENT_M)
            for end in ("min", "max")
        )
    except (safetensors.SafetensorError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"not a baseline file ({error})") from error
    faces = stored.pop("mesh.faces", np.zeros((0, 3), np.int32))
    if faces.dtype != np.int32 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"tensor mesh.faces is {faces.dtype} {list(faces.shape)}")
    if not 1 <= len(faces) <= MAX_FACES:
        raise ValueError(f"{len(faces)} faces; 1 to {MAX_FACES} are allowed")
    tensors = {name: array.astype(np.float32) for name, array in stored.items()}
    check_finite(tensors)
    vertex_uv = tensors.pop("mesh.vertex_uv", np.zeros((0, 2), np.float32))
    return BaselineAvatar(
        spec=spec,
        tensors=tensors,
        vertex_uv=vertex_uv,
        faces=faces,
        bounds_min_m=low,
        bounds_max_m=high,
    )
