"""What the pixel decoder is told about a surface point, in plain numpy: the judge of the others.

An encoding is a few parts side by side (`spec.ENCODINGS`). Each part is one function here, one
class in torch (`model.encodings`), one graph in ONNX (in the tests) and one file of GLSL:

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
from pica_core.reference.sampling import Dtype, sample_bilinear, sample_linear
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
