"""The numbers of an avatar's networks, laid out for the shaders that evaluate them. Pure.

Shaders compute four channels at once, so weights are 4x4 blocks of four texels, or columns of a
``mat4``: that of an input channel holds what it adds to each of four outputs. Channels are padded
with zeros to multiples of four, which a sine layer keeps at zero.

Decoders (`lay_out`): avatars of one `Plan` have their numbers at the same places of arrays of the
same shapes:

    half, exact    tables of the decoder's numbers: in 16-bit floats what files store with no more
    basis          directions of all regions, signed bytes: code 128 is 0, 127 steps are 1
    places S       of each vertex of level S: its column in the basis, and the first and the one
                   after the last of its rows there
    mean S         where it is at rest, metres

The pixel decoder (`siren_source`): constants, or a uniform block (`pack_weights`) with which one
program serves all avatars. The inputs of its first layer, as the shader fills its vectors:

    vector 0  expression    vector 1  encoded xyz    then the surface encoding, part by part:
    joint  m_uv    axes  m_u in xy, m_v in zw    uv  u, v    sinusoids  an octave in each of ten
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from typing import Literal

import numpy as np

from pica_core.avatar.file import Avatar
from pica_core.avatar.levels import local_name
from pica_core.avatar.linear import PREFIX, RANK, REGION
from pica_core.avatar.spec import (
    MAP_SIZE,
    PIXEL_CHANNELS,
    POSITION_CHANNELS,
    XYZ_CHANNELS,
    AvatarSpec,
    decoder_layers,
)
from pica_core.types import NUM_LATENT, Array, FloatArray

VECTOR = 4
TABLE_COLUMNS = 1024
"""Texels in a row of a table: a power of two that every driver has."""
DIRECTIONS_STEP, SHEET_STEP = 512, 32
"""Room for the directions of all regions and for the rows of a sheet comes in multiples of these
(chosen: the shipped avatars have 1,418 to 1,489, and 77 to 113)."""
TableName = Literal["half", "exact"]
CONVOLVE, EXPAND, DENSE = (f"decode_{name}.frag" for name in ("convolve", "expand", "dense"))
FULL, GATHER, SHEET = (f"decode_{name}.frag" for name in ("full", "gather", "sheet"))
"""What draws a head's own maps."""
SINE_COEFFICIENTS = (6.283164044063381, -41.33714233439381, 81.34076751798747, -70.99341896675098)
"""sin(2 pi s) over a quarter turn either way as an odd polynomial of s: the one whose largest
error, 6e-7, is least (weighted least squares, the weights grown where the error is)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Pass:
    """One step for all heads at once."""

    shader: str
    """File of its fragment shader."""
    defines: Mapping[str, int]
    """Sizes, and where its numbers begin in their table."""
    columns: int
    rows: int
    """Texels that a head takes of each image that it draws."""
    table: TableName

    @property
    def num_images(self) -> int:
        """One, or one for each place in a block of 2 x 2 texels."""
        return 1 if self.shader == DENSE else 4


@dataclass(frozen=True, kw_only=True, slots=True)
class Plan:
    """The steps of a decoder."""

    trunk: tuple[Pass, ...]
    """Towards the full expression map: a convolution and an expansion for each block."""
    full: Pass
    """The last expansion, straight into a head's own map."""
    exits: Mapping[int, tuple[int, Pass]]
    """To the map of a level below: so many steps of the trunk, and the one after them."""
    vertices: tuple[Pass, ...]
    """From latents to weights of bases, and to the directions of all regions."""
    sheet_rows: Mapping[int, int]
    """Room for the vertices of each level, rows of so many columns."""

    def trunk_length(self, level: int) -> int:
        """How many steps of the trunk a level takes."""
        return self.exits[level][0] if level in self.exits else len(self.trunk)


class _Table:
    """Texels that are added one after the other."""

    def __init__(self) -> None:
        self._parts: list[Array] = []
        self._length = 0

    def add(self, texels: Array) -> int:
        """Add texels ``[..., 4]``; where they begin."""
        start = self._length
        self._parts.append(texels.reshape(-1, VECTOR))
        self._length += len(self._parts[-1])
        return start

    def rows(self) -> FloatArray:
        """All of them, in rows."""
        found = np.zeros((-(-self._length // TABLE_COLUMNS), TABLE_COLUMNS, VECTOR), np.float32)
        found.reshape(-1, VECTOR)[: self._length] = np.concatenate(self._parts)
        return found


def vectors(channels: int) -> int:
    """Texels of four that so many channels fill."""
    return -(-channels // VECTOR)


def lay_out(avatar: Avatar) -> tuple[Plan, dict[str, Array]] | None:
    """An avatar's steps, and its arrays ``[rows, columns, channels]``.

    Returns:
        None if shaders do not evaluate such avatars: those of another block, those without bases,
        and those with finer numbers than files hold.
    """
    spec, tensors = avatar.spec, avatar.tensors
    if spec.block != "G" or spec.geometry != "bases":
        return None
    half, exact = _Table(), _Table()
    trunk: list[Pass] = []
    for layer in decoder_layers(spec, "expression"):
        ins, size = vectors(layer.in_channels), layer.size
        if layer.kind == "conv3":
            weight, bias = (tensors[f"{layer.name}{part}.weight"] for part in ("", "_bias"))
            trunk.append(_convolution(weight, bias, half, "half", is_first=not trunk))
        elif layer.kind == "conv1":
            outs, weight = vectors(layer.out_channels // VECTOR), tensors[f"{layer.name}.weight"]
            defines = {"SIZE": size, "IN_VECTORS": ins, "WEIGHTS": half.add(_phases(weight))}
            defines["BIAS"] = half.add(_phase_biases(tensors[f"{layer.name}.bias"]))
            trunk.append(
                Pass(
                    shader=EXPAND if 2 * size < MAP_SIZE else FULL,
                    defines=defines,
                    columns=outs * size,
                    rows=size,
                    table="half",
                )
            )
    exits = {}
    for level in avatar.levels[:-1]:
        name, own = f"level.{level}.expression", tensors.get(local_name(level))
        steps = next(n for n, step in enumerate(trunk) if step.defines["SIZE"] == level)
        weight, bias = tensors[f"{name}.weight"], tensors[f"{name}.bias"]
        exits[level] = steps, _convolution(weight, bias, exact, "exact", local=own)
    weight, mix = tensors[f"{PREFIX}weight"], tensors[f"{PREFIX}mix"]
    bases = {"IN_VECTORS": NUM_LATENT // VECTOR, "WEIGHTS": exact.add(_blocks(weight))}
    bases["BIAS"] = exact.add(_padded(tensors[f"{PREFIX}bias"], 0))
    mix = _padded(mix, 0, DIRECTIONS_STEP)
    directions = {"IN_VECTORS": vectors(len(weight)), "WEIGHTS": half.add(_blocks(mix))}
    columns = (vectors(len(weight)), vectors(len(mix)))
    sheets = {level: _sheet(avatar, level) for level in avatar.levels}
    plan = Plan(
        trunk=tuple(trunk[:-1]),
        full=trunk[-1],
        exits=exits,
        vertices=(
            Pass(shader=DENSE, defines=bases, columns=columns[0], rows=1, table="exact"),
            Pass(shader=DENSE, defines=directions, columns=columns[1], rows=1, table="half"),
        ),
        sheet_rows={level: len(mean) for level, (_, mean) in sheets.items()},
    )
    numbers, scaled = half.rows(), tensors[f"{PREFIX}basis"] * np.float32(127)
    small, codes = numbers.astype(np.float16), np.rint(scaled)
    if not np.array_equal(small, numbers) or np.abs(codes - scaled).max() > 1e-3:
        return None
    arrays: dict[str, Array] = {"half": small, "exact": exact.rows()}
    arrays["basis"] = _padded((codes + 128).astype(np.uint8), 0, DIRECTIONS_STEP)
    for level, (places, mean) in sheets.items():
        arrays |= {f"places {level}": places, f"mean {level}": mean}
    return plan, arrays


def _sheet(avatar: Avatar, level: int) -> tuple[Array, Array]:
    """Places and means of a level's vertices."""
    vertex = avatar.sheet_places(level)
    ends = np.cumsum(avatar.tensors[RANK])
    starts = ends - avatar.tensors[RANK]
    region = vertex // REGION
    places = np.stack([vertex % REGION, starts[region], ends[region]], axis=1).astype(np.uint16)
    mean = avatar.tensors[f"{PREFIX}mean"].reshape(-1, 3)[vertex]
    both = (array.reshape(-1, level, 3) for array in (places, mean))
    places, mean = (_padded(array, 0, SHEET_STEP) for array in both)
    return places, mean


def _convolution(
    weight: Array,
    bias: Array,
    table: _Table,
    table_name: TableName,
    *,
    is_first: bool = False,
    local: Array | None = None,
) -> Pass:
    """A 3x3 convolution with a bias for each texel, and a LeakyReLU; an exit has none, and may have
    weights of its own for each block of 2 x 2 texels."""
    (num_out, num_in), size = weight.shape[:2], bias.shape[-1]
    defines = {"SIZE": size, "IN_VECTORS": vectors(num_in), "IS_LEAKY": int(table_name == "half")}
    defines["WEIGHTS"] = table.add(_kernels(weight))
    defines["BIAS"] = table.add(_texels(bias))
    if is_first:
        defines["FIRST"] = 1
    if local is not None:
        spread = _padded(_padded(local.reshape(*local.shape[:2], num_out, num_in), 2), 3)
        spread = spread.reshape(*local.shape[:2], vectors(num_out), VECTOR, -1, VECTOR)
        defines["LOCAL"] = table.add(spread.transpose(2, 0, 1, 4, 5, 3))
    return Pass(
        shader=CONVOLVE,
        defines=defines,
        columns=vectors(num_out) * size // 2,
        rows=size // 2,
        table=table_name,
    )


def _padded(array: Array, axis: int, step: int = VECTOR) -> Array:
    """With zeros up to the next multiple of a step along an axis."""
    edges = [(0, 0)] * array.ndim
    edges[axis] = (0, -array.shape[axis] % step)
    return np.pad(array, edges)


def _blocks(weight: Array) -> Array:
    """A matrix ``[out, in]`` as ``[out / 4, in / 4, 4 inputs, 4 outputs]``."""
    padded = _padded(_padded(weight, 0), 1)
    return padded.reshape(len(padded) // VECTOR, VECTOR, -1, VECTOR).transpose(0, 2, 3, 1)


def _kernels(weight: Array) -> Array:
    """A 3x3 convolution ``[out, in, 3, 3]`` as ``[out / 4, in / 4, 3, 3, 4 inputs, 4 outputs]``."""
    padded = _padded(_padded(weight, 0), 1)
    tiles = padded.reshape(len(padded) // VECTOR, VECTOR, -1, VECTOR, 3, 3)
    return tiles.transpose(0, 2, 4, 5, 3, 1)


def _texels(bias: Array) -> Array:
    """A bias of each texel ``[C, S, S]`` as ``[C / 4, S, S, 4]``."""
    return _padded(bias, 0).reshape(-1, VECTOR, *bias.shape[1:]).transpose(0, 2, 3, 1)


def _phases(weight: Array) -> Array:
    """An expansion ``[4 C, in, 1, 1]`` as ``[C / 4, in / 4, 4 phases, 4 inputs, 4 outputs]``;
    channel 4 c + p becomes phase p of channel c."""
    padded = _padded(_padded(weight.reshape(len(weight) // VECTOR, VECTOR, -1), 0), 2)
    tiles = padded.reshape(len(padded) // VECTOR, VECTOR, VECTOR, -1, VECTOR)
    return tiles.transpose(0, 3, 2, 4, 1)


def _phase_biases(bias: Array) -> Array:
    """Its bias ``[4 C]`` as ``[C / 4, 4 phases, 4]``."""
    padded = _padded(bias.reshape(-1, VECTOR), 0)
    return padded.reshape(-1, VECTOR, VECTOR).transpose(0, 2, 1)


def _layers(spec: AvatarSpec) -> Iterator[tuple[str, int, int]]:
    """Name, inputs and outputs of each layer: the xyz SIREN, then the pixel decoder."""
    for prefix, inputs, widths in (
        ("xyz", POSITION_CHANNELS, XYZ_CHANNELS),
        ("pixel", spec.pixel_input_channels, PIXEL_CHANNELS),
    ):
        for index, outputs in enumerate(widths):
            yield f"{prefix}.{index}", inputs, outputs
            inputs = outputs


def pack_weights(spec: AvatarSpec, tensors: Mapping[str, Array]) -> tuple[FloatArray, FloatArray]:
    """Lay both SIRENs of an avatar out for the uniform block: matrices ``[M, 4, 4]``, row of blocks
    by row of blocks, layer after layer, and biases ``[B, 4]``, float32; std140 one after the
    other."""
    names = [name for name, _, _ in _layers(spec)]
    blocks = [_blocks(tensors[f"{name}.weight"]).reshape(-1, VECTOR, VECTOR) for name in names]
    biases = [_padded(tensors[f"{name}.bias"], 0).reshape(-1, VECTOR) for name in names]
    return np.concatenate(blocks, dtype=np.float32), np.concatenate(biases, dtype=np.float32)


def siren_source(spec: AvatarSpec, tensors: Mapping[str, Array] | None = None) -> str:
    """GLSL of both networks, layer by layer, without loops or arrays.

    Straight-line code, because software rasterisers neither unroll loops over arrays nor fold
    arrays of constants (llvmpipe, 98 K pixels: loops over a block 103 ms, straight 83, straight
    with constants 29).

    Args:
        tensors: An avatar's weights, to write them as constants: a program for this avatar alone,
            for machines without a circuit for sines. It computes them from a triangle wave and four
            coefficients (error 6e-7), so weights are in turns instead of radians. None reads
            weights from the block that `pack_weights` fills.
    """
    sizes = [(vectors(inputs), vectors(outputs)) for _, inputs, outputs in _layers(spec)]
    if tensors is None:
        lines = [
            "layout(std140) uniform Weights {",
            f"    mat4 matrices[{sum(ins * outs for ins, outs in sizes)}];",
            f"    vec4 biases[{sum(outs for _, outs in sizes)}];",
            "};",
        ]
        matrices = (f"matrices[{index}]" for index in count())
        biases = (f"biases[{index}]" for index in count())
        sine = "sin"
    else:
        sine = "sine_of_turns"
        lines = _sine_lines(sine)
        blocks, offsets = pack_weights(spec, _in_turns(spec, tensors))
        matrices = (_constant("mat4", block.ravel()) for block in blocks)
        biases = (_constant("vec4", offset) for offset in offsets)
    inputs = [f"p{index}" for index in range(sizes[len(XYZ_CHANNELS)][0])]
    parameters = ", ".join(f"vec4 {name}" for name in inputs)
    for head, values, layers, result in (
        ("vec4 encode_xyz(vec3 xyz_m)", ["vec4(xyz_m, 0.0)"], sizes[: len(XYZ_CHANNELS)], ""),
        (f"vec3 decode_pixel({parameters})", inputs, sizes[len(XYZ_CHANNELS) :], ".rgb"),
    ):
        lines.append(f"{head} {{")
        for index, (_, num_outputs) in enumerate(layers):
            is_last = bool(result) and index + 1 == len(layers)
            outputs = [f"h{index}_{number}" for number in range(num_outputs)]
            for name in outputs:
                terms = [next(biases), *(f"{next(matrices)} * {value}" for value in values)]
                total = " + ".join(terms)
                lines.append(f"    vec4 {name} = {total if is_last else f'{sine}({total})'};")
            values = outputs
        lines += [f"    return {values[0]}{result};", "}"]
    return "\n".join(lines)


def _in_turns(spec: AvatarSpec, tensors: Mapping[str, Array]) -> dict[str, Array]:
    """Weights whose sums are quarter turns ahead, in turns: what `_sine_lines` takes."""
    turned = dict(tensors)
    for name, _, _ in list(_layers(spec))[:-1]:
        weight, bias = f"{name}.weight", f"{name}.bias"
        turned[weight] = tensors[weight].astype(np.float64) / (2 * np.pi)
        turned[bias] = tensors[bias].astype(np.float64) / (2 * np.pi) + 0.25
    return turned


def _sine_lines(name: str) -> list[str]:
    """GLSL of sin(2 pi (t - 1/4)): a triangle wave carries the phase, a polynomial rounds it."""
    a, b, c, d = (f"{value:.8e}" for value in SINE_COEFFICIENTS)
    return [
        f"vec4 {name}(vec4 turns) {{",
        "    vec4 s = 0.25 - abs(fract(turns) - 0.5);",
        "    vec4 q = s * s;",
        f"    return s * ({a} + q * ({b} + q * ({c} + q * {d})));",
        "}",
    ]


def _constant(kind: str, values: Array) -> str:
    return f"{kind}({', '.join(f'{value:.8e}' for value in values)})"
