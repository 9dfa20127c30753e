"""The pixel decoder in plain numpy: the judge of torch, ONNX and GLSL.

Written to be read, in the order of the paper (Ma et al., "Pixel Codec Avatars", CVPR 2021, section
3 "Pixel Decoder" and appendix A.1), in float32 or in float64:

    u = m_uv(u, v) + [m_u(u), m_v(v)] side by side        joint and per-axis surface encodings
    x = sin(X_1 sin(X_0 xyz + b) + b)                     two-layer SIREN over the position
    p = [z, x, m_uv, m_u, m_v]                            z is the expression map at (u, v)
    c = P_3 sin(P_2 sin(P_1 sin(P_0 p))) + b              four layers, 307 numbers, last one linear

Every frequency (SIREN's omega) is folded into the weights. Sampling has texel centres at (i + 0.5)
/ W and clamps to the edge, as a GL sampler with CLAMP_TO_EDGE does.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from pica_core.errors import ShapeError
from pica_core.spec import AvatarSpec

Array = npt.NDArray[Any]
Dtype = type[np.float32] | type[np.float64]


def sample_bilinear(texture: npt.ArrayLike, uv: npt.ArrayLike, dtype: Dtype = np.float32) -> Array:
    """Look a map up between its four nearest texels.

    Args:
        texture: Map with row 0 at v = 0. ``[H, W, C]``.
        uv: Texture coordinates; outside [0, 1] the edge continues. ``[..., 2]``.
        dtype: Type to compute in.

    Returns:
        Samples ``[..., C]``.

    Raises:
        ShapeError: Not ``[H, W, C]`` and ``[..., 2]``.
    """
    texels, where = np.asarray(texture, dtype), np.asarray(uv, dtype)
    if texels.ndim != 3 or where.shape[-1:] != (2,):
        raise ShapeError(
            f"texture {texels.shape} and uv {where.shape}; [H, W, C] and [..., 2] wanted"
        )
    height, width, _ = texels.shape
    left, right, across = _neighbours(where[..., 0], width)
    top, bottom, down = _neighbours(where[..., 1], height)
    upper = _mix(texels[top, left], texels[top, right], across)
    lower = _mix(texels[bottom, left], texels[bottom, right], across)
    return _mix(upper, lower, down)


def sample_linear(table: npt.ArrayLike, t: npt.ArrayLike, dtype: Dtype = np.float32) -> Array:
    """Look a table ``[L, C]`` up at `t` ``[...]`` in [0, 1]; returns ``[..., C]``."""
    entries, where = np.asarray(table, dtype), np.asarray(t, dtype)
    if entries.ndim != 2:
        raise ShapeError(f"table is {entries.shape}; [L, C] wanted")
    low, high, weight = _neighbours(where, len(entries))
    return _mix(entries[low], entries[high], weight)


def siren(
    tensors: Mapping[str, Array],
    prefix: str,
    num_layers: int,
    inputs: Array,
    *,
    last_is_linear: bool,
    dtype: Dtype = np.float32,
) -> Array:
    """Run ``{prefix}.{i}.weight/bias`` over `inputs` ``[..., in]`` with a sine after each layer."""
    values: Array = np.asarray(inputs, dtype)
    for index in range(num_layers):
        weight: Array = np.asarray(tensors[f"{prefix}.{index}.weight"], dtype)
        bias: Array = np.asarray(tensors[f"{prefix}.{index}.bias"], dtype)
        values = np.matmul(values, weight.T) + bias
        if index + 1 < num_layers or not last_is_linear:
            values = np.sin(values)
    return values


def pixel_inputs(
    spec: AvatarSpec,
    tensors: Mapping[str, Array],
    expression: npt.ArrayLike,
    xyz_m: npt.ArrayLike,
    uv: npt.ArrayLike,
    dtype: Dtype = np.float32,
) -> Array:
    """The vector p of every pixel: ``[..., 16]`` in the paper's sizes.

    Args:
        spec: Sizes.
        tensors: An avatar's tensors.
        expression: Expression code z at the pixel. ``[..., 4]``.
        xyz_m: Head-frame position, metres. ``[..., 3]``.
        uv: Texture coordinates. ``[..., 2]``.
        dtype: Type to compute in.
    """
    where = np.asarray(uv, dtype)
    position = np.asarray(xyz_m, dtype)
    x = siren(tensors, "xyz", len(spec.xyz_channels), position, last_is_linear=False, dtype=dtype)
    m_uv = sample_bilinear(tensors["uv_encoding"], where, dtype)
    m_u = sample_linear(tensors["u_encoding"], where[..., 0], dtype)
    m_v = sample_linear(tensors["v_encoding"], where[..., 1], dtype)
    return np.concatenate([np.asarray(expression, dtype), x, m_uv, m_u, m_v], axis=-1)


def decode_pixels(
    spec: AvatarSpec,
    tensors: Mapping[str, Array],
    expression: npt.ArrayLike,
    xyz_m: npt.ArrayLike,
    uv: npt.ArrayLike,
    dtype: Dtype = np.float32,
) -> Array:
    """Colour pixels: RGB ``[..., 3]``, 0..1 but *not* clamped. Arguments as for `pixel_inputs`."""
    p = pixel_inputs(spec, tensors, expression, xyz_m, uv, dtype)
    return siren(tensors, "pixel", len(spec.pixel_channels), p, last_is_linear=True, dtype=dtype)


def count_parameters(tensors: Mapping[str, Array], prefix: str) -> int:
    """Count the numbers in ``{prefix}.*``: ``"pixel"`` has 307 in the paper's sizes."""
    return sum(array.size for name, array in tensors.items() if name.startswith(f"{prefix}."))


def _neighbours(t: Array, count: int) -> tuple[Array, Array, Array]:
    """Indices of the two texels around `t`, and the weight of the second."""
    place = t * t.dtype.type(count) - t.dtype.type(0.5)
    floor = np.floor(place)
    low = np.clip(floor, 0, count - 1).astype(np.int64)
    high = np.clip(floor + 1, 0, count - 1).astype(np.int64)
    return low, high, (place - floor)[..., None]


def _mix(a: Array, b: Array, weight: Array) -> Array:
    mixed: Array = a + (b - a) * weight
    return mixed
