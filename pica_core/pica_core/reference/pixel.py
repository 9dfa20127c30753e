"""The pixel decoder in plain numpy: the judge of torch, ONNX and GLSL.

Written to be read, in the order of the paper (Ma et al., "Pixel Codec Avatars", CVPR 2021, section
3 "Pixel Decoder" and appendix A.1), in float32 or in float64:

    u = m_uv(u, v) + [m_u(u), m_v(v)] side by side        joint and per-axis surface encodings,
                                                          or another one (`surface_encoding`)
    x = sin(X_1 sin(X_0 xyz + b) + b)                     two-layer SIREN over the position
    p = [z, x, u]                                         z is the expression map at (u, v)
    c = P_3 sin(P_2 sin(P_1 sin(P_0 p))) + b              four layers, 307 numbers, last one linear

Every frequency (SIREN's omega) is folded into the weights. How maps are looked up: `sampling`.
"""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from pica_core.avatar.spec import AvatarSpec
from pica_core.reference.sampling import Dtype
from pica_core.reference.surface_encoding import encode_surface
from pica_core.types import Array


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
