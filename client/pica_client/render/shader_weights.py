"""The numbers of a pixel decoder, packed for its uniform block: 4x4 blocks, so one program serves
all avatars.

The block is std140: first every matrix as 4x4 blocks (columns of four floats, as GLSL's ``mat4``),
row of blocks by row of blocks, layer after layer; then every bias in vectors of four. Widths that
are no multiple of four are padded with zeros, which a sine layer keeps at zero.

The inputs of the pixel decoder's first layer, as the shader fills its vectors:

    vector 0  expression    vector 1  encoded xyz    then the surface encoding, part by part:
    joint  m_uv    axes  m_u in xy, m_v in zw    uv  u, v    sinusoids  an octave in each of ten
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pica_core.avatar.spec import PIXEL_CHANNELS, POSITION_CHANNELS, XYZ_CHANNELS, AvatarSpec
from pica_core.types import Array

VECTOR = 4

SINE_COEFFICIENTS = (6.283164044063381, -41.33714233439381, 81.34076751798747, -70.99341896675098)
"""sin(2 pi s) over a quarter turn either way as an odd polynomial of s: the one whose largest
error, 6e-7, is least (weighted least squares, the weights grown where the error is)."""


@dataclass(frozen=True, slots=True)
class LayerBlock:
    """Where one layer lies in the block."""

    name: str
    matrix: int
    """Index of its first 4x4 block."""
    bias: int
    """Index of its first vector of biases."""
    inputs: int
    """Without padding, as the outputs are."""
    outputs: int

    @property
    def in_vectors(self) -> int:
        """Vectors of four that the shader reads."""
        return _vectors(self.inputs)

    @property
    def out_vectors(self) -> int:
        """Vectors of four that the shader writes."""
        return _vectors(self.outputs)


def layer_blocks(spec: AvatarSpec) -> list[LayerBlock]:
    """The layers in the order of the block: the xyz SIREN, then the pixel decoder."""
    blocks: list[LayerBlock] = []
    matrix = bias = 0
    for prefix, inputs, widths in (
        ("xyz", POSITION_CHANNELS, XYZ_CHANNELS),
        ("pixel", spec.pixel_input_channels, PIXEL_CHANNELS),
    ):
        for index, outputs in enumerate(widths):
            block = LayerBlock(f"{prefix}.{index}", matrix, bias, inputs, outputs)
            blocks.append(block)
            matrix += block.in_vectors * block.out_vectors
            bias += block.out_vectors
            inputs = outputs
    return blocks


def block_sizes(spec: AvatarSpec) -> tuple[int, int]:
    """How many 4x4 blocks and bias vectors there are."""
    last = layer_blocks(spec)[-1]
    return last.matrix + last.in_vectors * last.out_vectors, last.bias + last.out_vectors


def pack_weights(spec: AvatarSpec, tensors: Mapping[str, Array]) -> bytes:
    """Lay both SIRENs of an avatar out for the uniform block."""
    num_matrices, num_biases = block_sizes(spec)
    matrices = np.zeros((num_matrices, VECTOR, VECTOR), np.float32)
    biases = np.zeros((num_biases, VECTOR), np.float32)
    for block in layer_blocks(spec):
        ins, outs = block.in_vectors, block.out_vectors
        padded = np.zeros((outs * VECTOR, ins * VECTOR), np.float32)
        padded[: block.outputs, : block.inputs] = tensors[f"{block.name}.weight"]
        tiles = padded.reshape(outs, VECTOR, ins, VECTOR).transpose(0, 2, 3, 1)
        matrices[block.matrix : block.matrix + ins * outs] = tiles.reshape(-1, VECTOR, VECTOR)
        flat = biases[block.bias : block.bias + outs].reshape(-1)
        flat[: block.outputs] = tensors[f"{block.name}.bias"]
    return matrices.tobytes() + biases.tobytes()


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
    num_matrices, num_biases = block_sizes(spec)
    if tensors is None:
        lines = [
            "layout(std140) uniform Weights {",
            f"    mat4 matrices[{num_matrices}];",
            f"    vec4 biases[{num_biases}];",
            "};",
        ]
        matrices = [f"matrices[{index}]" for index in range(num_matrices)]
        biases = [f"biases[{index}]" for index in range(num_biases)]
        sine = "sin"
    else:
        sine = "sine_of_turns"
        lines = _sine_lines(sine)
        floats = np.frombuffer(pack_weights(spec, _in_turns(spec, tensors)), np.float32)
        split = num_matrices * VECTOR * VECTOR
        matrices = [_constant("mat4", row) for row in floats[:split].reshape(-1, VECTOR * VECTOR)]
        biases = [_constant("vec4", row) for row in floats[split:].reshape(-1, VECTOR)]
    blocks = layer_blocks(spec)
    inputs = [f"p{index}" for index in range(_vectors(spec.pixel_input_channels))]
    for prefix, head, values in (
        ("xyz", "vec4 encode_xyz(vec3 xyz_m)", ["vec4(xyz_m, 0.0)"]),
        ("pixel", f"vec3 decode_pixel({', '.join(f'vec4 {name}' for name in inputs)})", inputs),
    ):
        lines.append(f"{head} {{")
        for block in blocks:
            if not block.name.startswith(prefix):
                continue
            outputs = []
            for out in range(block.out_vectors):
                name = f"h{block.name.partition('.')[2]}_{out}"
                first = block.matrix + out * block.in_vectors
                terms = [
                    f"{matrices[first + index]} * {values[index]}"
                    for index in range(block.in_vectors)
                ]
                total = " + ".join([biases[block.bias + out], *terms])
                is_last = block is blocks[-1]
                lines.append(f"    vec4 {name} = {total if is_last else f'{sine}({total})'};")
                outputs.append(name)
            values = outputs
        lines.append(f"    return {values[0]}{'.rgb' if prefix == 'pixel' else ''};")
        lines.append("}")
    return "\n".join(lines)


def _in_turns(spec: AvatarSpec, tensors: Mapping[str, Array]) -> dict[str, Array]:
    """Weights whose sums are quarter turns ahead, in turns: what `_sine_lines` takes."""
    turned = dict(tensors)
    for block in layer_blocks(spec)[:-1]:
        weight, bias = f"{block.name}.weight", f"{block.name}.bias"
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


def _vectors(count: int) -> int:
    return -(-count // VECTOR)
