"""What the pixel decoder is told about a surface point, in plain numpy: the judge of the others.

An encoding is a few parts side by side (`spec.ENCODINGS`). Each part is one class here, one in
torch (`model.encodings`), one in ONNX (for the tests) and one file of GLSL:

    joint       m_uv(u, v), a learned map read bilinearly           uv_encoding        [T, T, 4]
    axes        m_u(u), m_v(v), learned tables read linearly        u_, v_encoding     [L, 2]
    uv          2 u - 1, 2 v - 1: the coordinates in [-1, 1]        no tensors
    sinusoids   for k = 0..9: sin and cos of 2 pi 2^k (u, v)        no tensors

The order of the sinusoids is sin u, sin v, cos u, cos v of one octave, then the next. With
coordinates in [-1, 1], as in Mildenhall et al., "NeRF" (2020), section 5.1, they are those of that
paper but for a sign in the first octave, which the weights behind them absorb.

Source of joint and axes: Ma et al., "Pixel Codec Avatars" (CVPR 2021), section 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol, final

import numpy as np
import numpy.typing as npt

from pica_core.avatar.spec import NUM_FREQUENCIES, AvatarSpec
from pica_core.reference.sampling import Dtype, sample_bilinear, sample_linear
from pica_core.types import Array

Shapes = dict[str, tuple[int, ...]]


class SurfacePart(Protocol):
    """One part of a surface encoding."""

    def tensor_shapes(self, spec: AvatarSpec) -> Shapes:
        """Name and shape of its tensors in an avatar file."""

    def encode(self, tensors: Mapping[str, Array], uv: Array, dtype: Dtype) -> Array:
        """Points ``[..., 2]`` to codes ``[..., C]``, computed in `dtype`."""


@final
class JointMap:
    """m_uv: one code for each place of the surface."""

    def tensor_shapes(self, spec: AvatarSpec) -> Shapes:
        """A square map, row 0 at v = 0."""
        size = spec.uv_encoding_size
        return {"uv_encoding": (size, size, spec.uv_encoding_channels)}

    def encode(self, tensors: Mapping[str, Array], uv: Array, dtype: Dtype) -> Array:
        """Bilinear lookup."""
        return sample_bilinear(tensors["uv_encoding"], uv, dtype)


@final
class AxisTables:
    """m_u and m_v: codes of a column and of a row, at a resolution that no map could have."""

    def tensor_shapes(self, spec: AvatarSpec) -> Shapes:
        """Two tables."""
        table = (spec.axis_encoding_size, spec.axis_encoding_channels)
        return {"u_encoding": table, "v_encoding": table}

    def encode(self, tensors: Mapping[str, Array], uv: Array, dtype: Dtype) -> Array:
        """Linear lookups."""
        along = (
            sample_linear(tensors[name], uv[..., axis], dtype)
            for axis, name in enumerate(("u_encoding", "v_encoding"))
        )
        return np.concatenate(list(along), axis=-1)


@final
class RawUv:
    """The coordinates themselves, as the xyz of the head: about [-1, 1]."""

    def tensor_shapes(self, spec: AvatarSpec) -> Shapes:
        """None."""
        return {}

    def encode(self, tensors: Mapping[str, Array], uv: Array, dtype: Dtype) -> Array:
        """2 uv - 1."""
        centred: Array = 2 * uv - dtype(1)
        return centred


@final
class Sinusoids:
    """Ten octaves of sines and cosines."""

    def tensor_shapes(self, spec: AvatarSpec) -> Shapes:
        """None."""
        return {}

    def encode(self, tensors: Mapping[str, Array], uv: Array, dtype: Dtype) -> Array:
        """Whole turns are taken off first: that is exact, and the sines stay so."""
        octaves: list[Array] = []
        for octave in range(NUM_FREQUENCIES):
            turns = uv * dtype(1 << octave)
            angle = (turns - np.floor(turns)) * dtype(2 * np.pi)
            octaves += [np.sin(angle), np.cos(angle)]
        return np.concatenate(octaves, axis=-1)


PARTS: Mapping[str, SurfacePart] = MappingProxyType(
    {"joint": JointMap(), "axes": AxisTables(), "uv": RawUv(), "sinusoids": Sinusoids()}
)


def encoding_shapes(spec: AvatarSpec) -> Shapes:
    """Name and shape of every tensor of a spec's encoding."""
    shapes: Shapes = {}
    for part in spec.encoding_channels:
        shapes |= PARTS[part].tensor_shapes(spec)
    return shapes


def encode_surface(
    spec: AvatarSpec, tensors: Mapping[str, Array], uv: npt.ArrayLike, dtype: Dtype
) -> Array:
    """The vector u of surface points.

    Args:
        spec: Sizes, and which parts there are.
        tensors: An avatar's tensors.
        uv: ``[..., 2]``.
        dtype: Type to compute in.

    Returns:
        ``[..., C]``; C is 8 in the paper, 0 where the decoder is told nothing.
    """
    where = np.asarray(uv, dtype)
    nothing: Array = np.zeros((*where.shape[:-1], 0), dtype)
    parts = [PARTS[part].encode(tensors, where, dtype) for part in spec.encoding_channels]
    return np.concatenate([nothing, *parts], axis=-1)
