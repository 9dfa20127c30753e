"""A baseline dressed in a given mean face, for where no trained one is at hand.

It looks right and costs what a trained one costs; its motion means nothing.
"""

import numpy as np

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.baseline import BaselineAvatar, BaselineSpec
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import POSITION_CHANNELS, RGB_CHANNELS
from pica_core.reference.decoders import FRONT, decode_expression_map
from pica_core.reference.pixel import decode_pixels
from pica_core.reference.sampling import sample_bilinear
from pica_core.types import Array, FloatArray

MESH_SPREAD_M = 2e-4
"""Standard deviation of the random motion of a vertex, metres, for unit latents."""
TEXTURE_SPREAD = 0.01
"""Standard deviation of the random change of a texel, where 1.0 is white."""
BAKED_ROWS = 64
"""Rows of a texture that are baked at once, to bound memory."""


def baseline_like(avatar: Avatar, seed: int = 0) -> BaselineAvatar:
    """A baseline that looks like an avatar at rest and costs what the published one costs.

    Its mesh is the avatar's level whose number of triangles is nearest to the published 10,936. The
    last biases are the neutral mesh and the neutral texture as seen from the front; all weights are
    random, and small where they would show.
    """
    meshes = [avatar.level_faces(level) for level in avatar.levels]
    mesh = min(meshes, key=lambda faces: abs(len(faces) - 10_936))
    kept, faces = np.unique(mesh, return_inverse=True)
    vertex_uv = np.ascontiguousarray(avatar.tensors["mesh.vertex_uv"][kept], np.float32)
    spec = BaselineSpec(num_vertices=len(kept))
    tensors = _random_weights(spec, seed)
    tensors["mesh.bias"] = avatar.mean_vertices_m[kept].reshape(-1)
    last = len(spec.channels) - 1
    texture = bake_texture(avatar, spec.texture_size)
    tensors[f"texture.{last}.bias"] = np.ascontiguousarray(texture.transpose(2, 0, 1))
    return BaselineAvatar(
        spec=spec,
        tensors=tensors,
        vertex_uv=vertex_uv,
        faces=faces.reshape(-1, 3).astype(np.int32),
        bounds_min_m=avatar.manifest.bounds_min_m,
        bounds_max_m=avatar.manifest.bounds_max_m,
    )


def bake_texture(avatar: Avatar, size: int) -> FloatArray:
    """The neutral face, seen from the front, as a texture.

    Returns:
        sRGB, 1.0 is white, clamped to [0, 1]. float32 ``[size, size, 3]``; between the charts of
        the mesh it holds what the pixel decoder happens to say there.
    """
    neutral = ExpressionEncoder(avatar).encode(np.zeros(NUM_ARKIT, np.float32))
    codes = decode_expression_map(avatar, neutral, FRONT).astype(np.float32)
    mean = _mean_map(avatar)
    texel = (np.arange(size, dtype=np.float32) + 0.5) / size
    texture = np.empty((size, size, RGB_CHANNELS), np.float32)
    for start in range(0, size, BAKED_ROWS):
        rows = texel[start : start + BAKED_ROWS]
        uv = np.stack(np.meshgrid(texel, rows), axis=-1)
        pixels = sample_bilinear(codes, uv), sample_bilinear(mean, uv), uv
        texture[start : start + len(rows)] = decode_pixels(avatar.spec, avatar.tensors, *pixels)
    return np.clip(texture, 0, 1, out=texture)


def _mean_map(avatar: Avatar) -> FloatArray:
    """The mesh at rest as a map ``[S, S, 3]``; of bases, the mean of each texel's vertices."""
    if avatar.spec.geometry == "decoder":
        return avatar.tensors["geometry.mean"]
    size = avatar.spec.map_size
    texel = np.minimum((avatar.tensors["mesh.vertex_uv"] * size).astype(int), size - 1)
    sums = np.zeros((size, size, POSITION_CHANNELS + 1))
    ones = np.ones((len(texel), 1))
    np.add.at(sums, (texel[:, 1], texel[:, 0]), np.hstack([avatar.mean_vertices_m, ones]))
    while (sums[..., 3] == 0).any():  # texels between vertices take their neighbours' mean
        empty = sums[..., 3] == 0
        near = np.sum([np.roll(sums, step, axis) for step in (-1, 1) for axis in (0, 1)], axis=0)
        sums[empty] = near[empty]
    return (sums[..., :3] / sums[..., 3:]).astype(np.float32)


def _random_weights(spec: BaselineSpec, seed: int) -> dict[str, Array]:
    """He's variance for leaky units throughout, biases zero, the two last layers nearly silent."""
    rng = np.random.default_rng(seed)
    tensors: dict[str, Array] = {}
    last = f"texture.{len(spec.channels) - 1}.weight"
    for name, shape in spec.tensor_shapes().items():
        if name.endswith(".bias"):
            tensors[name] = np.zeros(shape, np.float32)
            continue
        inputs = 4 * shape[0] if len(shape) == 4 else shape[1]
        spread = np.sqrt(1.9 / inputs)
        if name == "mesh.weight":
            spread = MESH_SPREAD_M / np.sqrt(inputs)
        elif name == last:
            spread = TEXTURE_SPREAD / np.sqrt(inputs)
        tensors[name] = rng.standard_normal(shape, dtype=np.float32) * np.float32(spread)
    return tensors
