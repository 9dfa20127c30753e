"""The paper's baseline as a second kind of avatar: one network makes vertices and a whole texture.

Deep Appearance Models (Lombardi et al. 2018) as later published with a face capture data set; the
decoder alone, since that is what a receiver runs and what the paper's runtime tables compare:

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

from collections.abc import Mapping
from dataclasses import dataclass
from math import prod

import numpy as np

from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import RGB_CHANNELS, VIEW_CHANNELS
from pica_core.latent import NUM_LATENT
from pica_core.types import Array, FloatArray, IntArray

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
