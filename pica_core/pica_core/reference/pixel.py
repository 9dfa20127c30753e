"""The pixel decoder in plain numpy: the judge of torch, ONNX and GLSL.

Written to be read, in the order of the paper (Ma et al., "Pixel Codec Avatars", CVPR 2021, section
3 "Pixel Decoder" and appendix A.1), in float32 or in float64:

    u = m_uv(u, v) + [m_u(u), m_v(v)] side by side        joint and per-axis surface encodings,
                                                          or another one (below)
    x = sin(X_1 sin(X_0 xyz + b) + b)                     two-layer SIREN over the position
    p = [z, x, u]                                         z is the expression map at (u, v)
    c = P_3 sin(P_2 sin(P_1 sin(P_0 p))) + b              four layers, 307 numbers, last one linear

Every frequency (SIREN's omega) is folded into the weights. How maps are looked up: `sampling`.

An encoding is a few parts side by side (`spec.ENCODINGS`). Each part is one function here, one
class in torch, one graph in ONNX (in the tests) and one file of GLSL:

    joint       m_uv(u, v), a learned map read bilinearly           uv_encoding        [T, T, 4]
    axes        m_u(u), m_v(v), learned tables read linearly        u_, v_encoding     [L, 2]
    uv          2 u - 1, 2 v - 1: the coordinates in [-1, 1]        no tensors
    sinusoids   for k = 0..9: sin and cos of 2 pi 2^k (u, v)        no tensors

The order of the sinusoids is sin u, sin v, cos u, cos v of one octave, then the next. With
coordinates in [-1, 1], as in Mildenhall et al., "NeRF" (2020), section 5.1, they are those of that
paper but for a sign in the first octave, which the weights behind them absorb.

Source of joint and axes: Ma et al., "Pixel Codec Avatars" (CVPR 2021), section 4.
"""

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from pica_core.avatar.spec import NUM_FREQUENCIES, AvatarSpec
from pica_core.sampling import Dtype, sample_bilinear, sample_linear
from pica_core.types import Array

Tensors = Mapping[str, Array]


def encode_surface(spec: AvatarSpec, tensors: Tensors, uv: npt.ArrayLike, dtype: Dtype) -> Array:
    """The vector u of surface points.

    Args:
        uv: ``[..., 2]``.

    Returns:
        ``[..., C]``; C is 8 in the paper, 0 where the decoder is told nothing.
    """
    where = np.asarray(uv, dtype)
    nothing: Array = np.zeros((*where.shape[:-1], 0), dtype)
    parts = [_PARTS[part](tensors, where, dtype) for part in spec.encoding_channels]
    return np.concatenate([nothing, *parts], axis=-1)


def _axes(tensors: Tensors, uv: Array, dtype: Dtype) -> Array:
    along_u = sample_linear(tensors["u_encoding"], uv[..., 0], dtype)
    along_v = sample_linear(tensors["v_encoding"], uv[..., 1], dtype)
    return np.concatenate([along_u, along_v], axis=-1)


def _sinusoids(tensors: Tensors, uv: Array, dtype: Dtype) -> Array:
    octaves: list[Array] = []
    for octave in range(NUM_FREQUENCIES):
        turns = uv * dtype(1 << octave)
        # Whole turns are taken off first: that is exact, and the sines stay so.
        angle = (turns - np.floor(turns)) * dtype(2 * np.pi)
        octaves += [np.sin(angle), np.cos(angle)]
    return np.concatenate(octaves, axis=-1)


_PARTS: Mapping[str, Callable[[Tensors, Array, Dtype], Array]] = {
    "joint": lambda tensors, uv, dtype: sample_bilinear(tensors["uv_encoding"], uv, dtype),
    "axes": _axes,
    "uv": lambda tensors, uv, dtype: 2 * uv - dtype(1),
    "sinusoids": _sinusoids,
}


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
        expression: Expression code z at the pixel. ``[..., 4]``.
        xyz_m: Head-frame position, metres. ``[..., 3]``.
        uv: Texture coordinates. ``[..., 2]``.
    """
    position = np.asarray(xyz_m, dtype)
    x = siren(tensors, "xyz", len(spec.xyz_channels), position, last_is_linear=False, dtype=dtype)
    surface = encode_surface(spec, tensors, uv, dtype)
    return np.concatenate([np.asarray(expression, dtype), x, surface], axis=-1)


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
