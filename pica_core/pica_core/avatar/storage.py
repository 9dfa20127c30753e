"""How an avatar's tensors are made small in its file, and large again in memory.

fp16, or 8 or 16 bit integers q with value = offset + scale * q per last-axis channel; the two
tables stand in the file's metadata key ``storage``. Integers that are integers anyway stay so.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from pica_core.avatar.levels import PREFIX as LEVEL_PREFIX
from pica_core.avatar.levels import STATIC_NAME, is_index
from pica_core.avatar.linear import SIGNED_STEP, signed_codes
from pica_core.types import Array

Storage = Literal["f32", "f16", "u8", "u16", "s8"]

MAX_MAGNITUDE = 1e6
"""Largest absolute value of any weight: trained ones are below 1e3; sums of products stay finite in
float32."""

_STORAGE: Mapping[str, Storage] = MappingProxyType(
    {
        "uv_encoding": "u8",
        "u_encoding": "f16",
        "v_encoding": "f16",
        "geometry.mean": "u16",
        "mesh.vertex_uv": "u16",
        "linear.mean": "u16",
        "linear.basis": "s8",
        "linear.mix": "f16",
    }
)
"""How `save_avatar` stores these; decoder and encoder weights are fp16, gains 8 bits, the two
SIRENs float32. A level's weights per block of texels are stored in 8 bits, its bias in fp16, the
rest of it in float32.

8 bits over the range of a channel are 0.004 of that range; 16 bits over a head are 5 micrometres
and over a UV 1/64 of a texel, where fp16 would be 60 micrometres and half a texel.
"""


def to_storage(name: str, array: Array, num_vertices: int) -> tuple[Array, dict[str, Any] | None]:
    """A tensor as the file holds it.

    Args:
        num_vertices: Vertices of the mesh: triangles of small meshes take half the bytes.

    Returns:
        What to write, and the table of scales and offsets if there is one.
    """
    if name == STATIC_NAME:
        return array, None
    if is_index(name):
        is_short = num_vertices <= 2**16 and array.max() < 2**16
        return array.astype(np.uint16 if is_short else np.int32), None
    kind = _STORAGE.get(name) or _usual(name)
    if kind == "s8":
        channels = array.shape[-1]
        offset = [-128 * SIGNED_STEP] * channels
        return signed_codes(array), {"scale": [SIGNED_STEP] * channels, "offset": offset}
    if kind in ("u8", "u16"):
        return _to_affine(array, np.uint8 if kind == "u8" else np.uint16)
    return array.astype(np.float32 if kind == "f32" else np.float16), None


def to_memory(name: str, stored: Array, affine: Any) -> Array:
    """A tensor as it was before `to_storage`, but for rounding.

    Args:
        affine: The file's tables by tensor, of any type: nothing is trusted.

    Raises:
        ValueError: The tensor needs a table, and it is missing or not of finite numbers.
    """
    if is_index(name):
        return stored.astype(np.int32)
    if name == STATIC_NAME:
        return stored
    if stored.dtype.kind == "f":
        return stored.astype(np.float32)
    entry = affine.get(name) if isinstance(affine, dict) else None
    channels: list[Array] = []
    for key in ("scale", "offset"):
        values = entry.get(key) if isinstance(entry, dict) else None
        proper = (
            isinstance(values, list)
            and len(values) == stored.shape[-1]
            and all(type(v) in (int, float) and abs(v) <= MAX_MAGNITUDE for v in values)
        )
        if not proper:
            raise ValueError(
                f"storage.{name}.{key} must be {stored.shape[-1]} finite numbers "
                f"up to {MAX_MAGNITUDE:g}"
            )
        channels.append(np.asarray(values, np.float32))
    memory: Array = channels[1] + channels[0] * stored.astype(np.float32)
    if name == "mesh.vertex_uv":  # the rounding of offset + scale * q may step over the edge
        np.clip(memory, 0, 1, out=memory)
    return memory


def _usual(name: str) -> Storage:
    if name.startswith(LEVEL_PREFIX):
        if name.endswith(".expression.local"):
            return "u8"
        return "f16" if name.endswith(".expression.bias") else "f32"
    if name.endswith(".gain.weight"):
        return "u8"
    return "f16" if name.startswith(("geometry.", "expression.", "encoder.")) else "f32"


def _to_affine(array: Array, dtype: type[np.unsignedinteger[Any]]) -> tuple[Array, dict[str, Any]]:
    levels = int(np.iinfo(dtype).max)
    flat = array.reshape(-1, array.shape[-1]).astype(np.float64)
    low, high = flat.min(axis=0), flat.max(axis=0)
    scale = np.where(high > low, (high - low) / levels, 1.0)
    codes = np.rint((flat - low) / scale).astype(dtype).reshape(array.shape)
    return codes, {"scale": scale.tolist(), "offset": low.tolist()}
