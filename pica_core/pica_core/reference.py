"""The decoders in plain numpy: the judge of torch, ONNX and GLSL.

Written to be read. The per-object decoders run in float64, each layer of `decoder_layers` in a few
lines, nothing rearranged; a frame takes a second, and for drawing there is
`graphs`. The pixel decoder is in the order of the paper (Ma et al., "Pixel Codec Avatars", CVPR
2021, section 3 "Pixel Decoder" and appendix A.1), in float32 or in float64:

    u = m_uv(u, v) + [m_u(u), m_v(v)] side by side        joint and per-axis surface encodings,
                                                          or another one (below)
    x = sin(X_1 sin(X_0 xyz + b) + b)                     two-layer SIREN over the position
    p = [z, x, u]                                         z is the expression map at (u, v)
    c = P_3 sin(P_2 sin(P_1 sin(P_0 p))) + b              four layers, 307 numbers, last one linear

Every frequency (SIREN's omega) is folded into the weights. How maps are looked up: `sampling`.

An encoding is a few parts side by side (`spec.ENCODINGS`). Each part is one function here, one in
torch and one file of GLSL. The order of the sinusoids is sin u, sin v, cos u, cos v of one octave,
then the next. With coordinates in [-1, 1], as in Mildenhall et al., "NeRF" (2020), section 5.1,
they are those of that paper but for a sign in the first octave, which the weights behind them
absorb.

Source of joint and axes: Ma et al., "Pixel Codec Avatars" (CVPR 2021), section 4.

The paper's baseline is a second kind of avatar, whose one network makes vertices and a whole
texture: Deep Appearance Models (Lombardi et al. 2018) as later published with a face capture data
set; the decoder alone, since that is what a receiver runs and what the paper's runtime tables
compare:

    view direction 3 -> 8; latent z -> z
    mesh      fully connected z -> 3V
    texture   fully connected z + 8 -> z x 4 x 4, then eight transposed convolutions 4x4, stride 2,
              to channels z, 64, 64, 32, 32, 16, 16, 3, each with an untied bias at its output size

A LeakyReLU (slope 0.2) follows every layer but the two that end in vertices and texture. At z = 256
and 7,306 vertices these are 17.4 M parameters and 755 M multiply-adds in the convolutions.

It is a measuring instrument: no file, no stream tables, no levels, nothing that a call needs.
`pica train --variant baseline` and `pica eval` measure a trained one, `pica bench decode` times one
of random weights (`baseline_like`).
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import prod

import numpy as np
import numpy.typing as npt

from pica_core.avatar.file import Avatar
from pica_core.avatar.levels import STILL_NAME, spread_local
from pica_core.avatar.linear import weights_of_latent
from pica_core.avatar.spec import (
    LEAKY_SLOPE,
    MAP_SIZE,
    NUM_FREQUENCIES,
    PIXEL_CHANNELS,
    POSITION_CHANNELS,
    RGB_CHANNELS,
    VIEW_CHANNELS,
    XYZ_CHANNELS,
    AvatarSpec,
    Layer,
    decoder_layers,
    trunk_layers,
)
from pica_core.sampling import Dtype, sample_bilinear, sample_linear
from pica_core.types import LATENT_SIZE, NUM_LATENT, Array, FloatArray, IntArray

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


def _connect(tensors: Tensors, layer: str, values: Array, dtype: Dtype) -> Array:
    """A fully connected layer over values ``[..., in]``."""
    weight, bias = (np.asarray(tensors[f"{layer}.{part}"], dtype) for part in ("weight", "bias"))
    return np.matmul(values, weight.T) + bias


def decode_pixels(
    spec: AvatarSpec,
    tensors: Mapping[str, Array],
    expression: npt.ArrayLike,
    xyz_m: npt.ArrayLike,
    uv: npt.ArrayLike,
    dtype: Dtype = np.float32,
) -> Array:
    """Colour pixels: RGB ``[..., 3]``, 0..1 but *not* clamped.

    Args:
        expression: Expression code z at the pixel. ``[..., 4]``.
        xyz_m: Head-frame position, metres. ``[..., 3]``.
        uv: Texture coordinates. ``[..., 2]``.
    """
    x: Array = np.asarray(xyz_m, dtype)
    for index in range(len(XYZ_CHANNELS)):
        x = np.sin(_connect(tensors, f"xyz.{index}", x, dtype))
    surface = encode_surface(spec, tensors, uv, dtype)
    p = np.concatenate([np.asarray(expression, dtype), x, surface], axis=-1)
    for index in range(len(PIXEL_CHANNELS) - 1):
        p = np.sin(_connect(tensors, f"pixel.{index}", p, dtype))
    return _connect(tensors, f"pixel.{len(PIXEL_CHANNELS) - 1}", p, dtype)


def count_parameters(tensors: Mapping[str, Array], prefix: str) -> int:
    """Count the numbers in ``{prefix}.*``: ``"pixel"`` has 307 in the paper's sizes."""
    return sum(array.size for name, array in tensors.items() if name.startswith(f"{prefix}."))


STILL_MAPS = 16
"""Avatars whose still map is kept: it takes a tenth of a second and a megabyte."""
FRONT = (0.0, 0.0, 1.0)
"""The direction from which a still map is seen."""


def decode_position_map(avatar: Avatar, latent: npt.ArrayLike, level: int | None = None) -> Array:
    """Where the face is.

    Args:
        latent: ``[8, 8, 4]``.
        level: One of the avatar's levels; None for the full one.

    Returns:
        Position map, head frame, metres, float64 ``[S, S, 3]``; where bases make them, the sheet of
        the level's vertices, ``[R, S, 3]``.
    """
    if avatar.spec.geometry == "bases":
        return _sheet(avatar, np.asarray(latent, np.float64), level)
    offset, _ = _decode(avatar, "geometry", np.asarray(latent, np.float64), level)
    mean = avatar.tensors["geometry.mean"].astype(np.float64)
    return mean + avatar.manifest.position_scale_m * offset.transpose(1, 2, 0)


def decode_expression_map(
    avatar: Avatar, latent: npt.ArrayLike, view_direction: npt.ArrayLike, level: int | None = None
) -> Array:
    """What the pixel decoder is told about every place of the face, seen from one side.

    Args:
        latent: ``[8, 8, 4]``.
        view_direction: Camera centre seen from the head, unit length, head frame. ``[3]``.
        level: One of the avatar's levels; None for the full one.

    Returns:
        Expression map, float64 ``[S, S, 4]``; below the full level what is added to `still_map`,
        where the avatar has one.
    """
    view = np.broadcast_to(np.asarray(view_direction, np.float64), (LATENT_SIZE, LATENT_SIZE, 3))
    seen = np.concatenate([np.asarray(latent, np.float64), view], axis=2)
    value, prefix = _decode(avatar, "expression", seen, level)
    if prefix:
        codes = _convolve(value, avatar.tensors[f"{prefix}expression.weight"])
        local = avatar.tensors.get(f"{prefix}expression.local")
        if local is not None:
            codes = codes + (spread_local(local) * value).sum(1)
        value = codes + avatar.tensors[f"{prefix}expression.bias"]
    return value.transpose(1, 2, 0)


@functools.lru_cache(maxsize=STILL_MAPS)
def still_map(avatar: Avatar) -> FloatArray | None:
    """The expression map of a face that does not move, to which levels below the full one add.

    Returns:
        float32 ``[S, S, 4]`` at the full level's size; None where levels stand for themselves.
    """
    latent = avatar.tensors.get(STILL_NAME)
    if latent is None:
        return None
    return decode_expression_map(avatar, latent, FRONT).astype(np.float32)


def _sheet(avatar: Avatar, latent: Array, level: int | None) -> Array:
    """Vertices by bases, region after region; what is left of the last row repeats the last one."""
    tensors, size = avatar.tensors, level or MAP_SIZE
    weights = weights_of_latent(tensors, latent)
    rows, start = [], 0
    for mean, rank in zip(tensors["linear.mean"], tensors["linear.rank"], strict=True):
        part = slice(start, start + int(rank))
        local = tensors["linear.mix"][part].astype(np.float64) @ weights
        moved = np.tensordot(local, tensors["linear.basis"][part], axes=1)
        rows.append(mean + avatar.manifest.position_scale_m * moved)
        start += int(rank)
    sheet = np.stack(rows)
    if size == MAP_SIZE:
        return sheet
    found = sheet.reshape(-1, POSITION_CHANNELS)[avatar.sheet_places(size)]
    return found.reshape(-1, size, POSITION_CHANNELS)


def _decode(avatar: Avatar, decoder: str, grid: Array, level: int | None) -> tuple[Array, str]:
    """What a decoder's layers make at a level, ``[C, S, S]``, and the prefix of its own tensors."""
    prefix, layers = "", decoder_layers(avatar.spec, decoder)
    if level is not None and level != MAP_SIZE:
        prefix, layers = f"level.{level}.", trunk_layers(avatar.spec, level)
    value = grid.transpose(2, 0, 1)
    for layer in layers:
        value = _run(layer, [avatar.tensors[name] for name in layer.tensor_shapes()], value)
    return value, prefix


def _run(layer: Layer, weights: list[Array], value: Array) -> Array:
    match layer.kind:
        case "conv3" | "conv1":
            value = _convolve(value, weights[0])
        case "deconv4":
            value = _deconvolve(value, weights[0])
        case "untied_bias":
            value = value + weights[0]
        case "untied_gain":
            value = value * weights[0]
        case "leaky_relu":
            value = np.where(value > 0, value, LEAKY_SLOPE * value)
        case "pixel_shuffle":
            phases = value.reshape(-1, 2, 2, *value.shape[1:]).transpose(0, 3, 1, 4, 2)
            value = phases.reshape(layer.out_channels, layer.size, layer.size)
    return value + weights[1][:, None, None] if layer.has_bias else value


def _convolve(image: Array, weight: Array) -> Array:
    """3x3 or 1x1 convolution of ``[C, H, W]``, zeros around it."""
    _, rows, columns = image.shape
    edge = weight.shape[2] // 2
    padded = np.pad(image, ((0, 0), (edge, edge), (edge, edge)))
    total = np.zeros((weight.shape[0], rows, columns))
    for y in range(weight.shape[2]):
        for x in range(weight.shape[3]):
            shifted = padded[:, y : y + rows, x : x + columns]
            total += np.tensordot(weight[:, :, y, x].astype(np.float64), shifted, axes=1)
    return total


def _deconvolve(image: Array, weight: Array) -> Array:
    """Transposed convolution 4x4, stride 2, padding 1: every input spreads over 4x4 outputs."""
    _, rows, columns = image.shape
    spread = np.zeros((weight.shape[1], 2 * rows + 2, 2 * columns + 2))
    for y in range(4):
        for x in range(4):
            part = np.tensordot(weight[:, :, y, x].T.astype(np.float64), image, axes=1)
            spread[:, y : y + 2 * rows : 2, x : x + 2 * columns : 2] += part
    return spread[:, 1:-1, 1:-1]


def still_colours(avatar: Avatar, xyz_m: npt.ArrayLike, uv: npt.ArrayLike) -> Array:
    """Colours of a face that does not move, seen from the front, RGB 0 to 1, ``[..., 3]``.

    Args:
        xyz_m: Places of the mesh at rest, head frame, metres. ``[..., 3]``.
        uv: Their texture coordinates. ``[..., 2]``.

    Raises:
        ValueError: The avatar has no still face.
    """
    still = still_map(avatar)
    if still is None:
        raise ValueError("the avatar has no tensor level.still")
    codes = sample_bilinear(still, uv)
    return np.clip(decode_pixels(avatar.spec, avatar.tensors, codes, xyz_m, uv), 0, 1)


VIEW_FEATURES = 8
"""Values that the view direction becomes."""
FIRST_SIZE = 4
"""Rows and columns of the texture decoder's first grid."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BaselineSpec:
    """Sizes of a baseline decoder; the defaults are those that were published."""

    num_latent: int = NUM_LATENT
    """Length z of the latent; ours, flattened, by default."""
    num_vertices: int = 7306
    channels: tuple[int, ...] = (NUM_LATENT, 64, 64, 32, 32, 16, 16, RGB_CHANNELS)
    """Output channels of the transposed convolutions."""

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
    """As `BaselineSpec.tensor_shapes` names and shapes them, float32."""
    vertex_uv: FloatArray
    """Where vertices lie in the texture, in [0, 1], row 0 is v = 0. float32 ``[V, 2]``."""
    faces: IntArray
    """int32 ``[F, 3]``, counter-clockwise seen from outside."""
    bounds_min_m: tuple[float, float, float]
    """Lower corner of all positions, head frame, metres."""
    bounds_max_m: tuple[float, float, float]
    """Upper corner of all positions, head frame, metres."""


def baseline_channels(texture_size: int) -> tuple[int, ...]:
    """The published channels for a texture of 1024 texels a side, or of 32, 64, ... below, for
    which the last layers but one are left out."""
    layers = (texture_size // FIRST_SIZE).bit_length() - 1
    return (*BaselineSpec().channels[: layers - 1], RGB_CHANNELS)


MESH_SPREAD_M = 2e-4
"""Standard deviation of the random motion of a vertex, metres, for unit latents."""


def baseline_like(avatar: Avatar, seed: int = 0) -> BaselineAvatar:
    """A baseline that costs what the published one costs, on an avatar's mesh at rest.

    Its mesh is the avatar's level whose number of triangles is nearest to the published 10,936. All
    weights are random, and small where they would move the mesh; its colours mean nothing.
    """
    meshes = [avatar.level_faces(level) for level in avatar.levels]
    mesh = min(meshes, key=lambda faces: abs(len(faces) - 10_936))
    kept, faces = np.unique(mesh, return_inverse=True)
    vertex_uv = np.ascontiguousarray(avatar.tensors["mesh.vertex_uv"][kept], np.float32)
    spec = BaselineSpec(num_vertices=len(kept))
    tensors = _random_weights(spec, seed)
    tensors["mesh.bias"] = avatar.mean_vertices_m[kept].reshape(-1)
    return BaselineAvatar(
        spec=spec,
        tensors=tensors,
        vertex_uv=vertex_uv,
        faces=faces.reshape(-1, 3).astype(np.int32),
        bounds_min_m=avatar.manifest.bounds_min_m,
        bounds_max_m=avatar.manifest.bounds_max_m,
    )


def _random_weights(spec: BaselineSpec, seed: int) -> dict[str, Array]:
    """He's variance for leaky units, biases zero, the mesh nearly still."""
    rng = np.random.default_rng(seed)
    tensors: dict[str, Array] = {}
    for name, shape in spec.tensor_shapes().items():
        tensors[name] = np.zeros(shape, np.float32)
        if name.endswith(".weight"):
            inputs = 4 * shape[0] if len(shape) == 4 else shape[1]
            spread = MESH_SPREAD_M if name == "mesh.weight" else np.sqrt(1.9)
            rng.standard_normal(out=tensors[name], dtype=np.float32)
            tensors[name] *= np.float32(spread / np.sqrt(inputs))
    return tensors
