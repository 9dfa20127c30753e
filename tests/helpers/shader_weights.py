"""Reads the uniform block of a pixel decoder back."""

from __future__ import annotations

import numpy as np

from pica_client.render.shader_weights import VECTOR, block_sizes, layer_blocks
from pica_core.avatar.spec import AvatarSpec
from pica_core.types import Array


def unpack_weights(spec: AvatarSpec, data: bytes) -> dict[str, Array]:
    """Read a packed block back: `pack_weights` reversed."""
    num_matrices, num_biases = block_sizes(spec)
    floats = np.frombuffer(data, np.float32)
    matrices = floats[: num_matrices * VECTOR * VECTOR].reshape(-1, VECTOR, VECTOR)
    biases = floats[num_matrices * VECTOR * VECTOR :].reshape(num_biases, VECTOR)
    tensors: dict[str, Array] = {}
    for block in layer_blocks(spec):
        ins, outs = block.in_vectors, block.out_vectors
        tiles = matrices[block.matrix : block.matrix + ins * outs].reshape(
            outs, ins, VECTOR, VECTOR
        )
        padded = tiles.transpose(0, 3, 1, 2).reshape(outs * VECTOR, ins * VECTOR)
        tensors[f"{block.name}.weight"] = padded[: block.outputs, : block.inputs]
        flat = biases[block.bias : block.bias + outs].reshape(-1)
        tensors[f"{block.name}.bias"] = flat[: block.outputs]
    return tensors
