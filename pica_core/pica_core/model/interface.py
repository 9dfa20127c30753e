"""What every trainable avatar offers, whatever it is made of.

A trainer needs no more than this: decode a mesh and something that says what the mesh looks like,
rasterise the mesh, ask for the colours of the pixels, and hand the weights to an optimiser in
groups.

    mesh = model.decode_mesh(latent)
    surface = ...                       rasterise mesh.vertices_m on the topology that it draws
    colours = model.shade(model.appearance(latent, view_direction), surface)

Meshes come in two topologies. "dense" is the one that the paper's full model draws; "tracked" is
the coarse one that a face tracker follows, which the mesh loss compares with, and which some
variants draw too. Both share one UV layout.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.linear import Bases, SplitBases
from pica_core.avatar.spec import ENCODER_CHANNELS, LEAKY_SLOPE, AvatarSpec, ModelCost, TopologyName
from pica_core.types import LATENT_CHANNELS, LATENT_SIZE, NUM_LATENT, FloatArray, IntArray

GroupName = Literal["shape", "appearance", "pixel", "encoding"]
ParameterGroups = dict[GroupName, list[nn.Parameter]]


class Surface(NamedTuple):
    """What rasterisation finds at K pixels of each of N images.

    Attributes:
        uv: Surface coordinates, ``[N, K, 2]``.
        xyz_m: Head-frame positions in metres, ``[N, K, 3]``.
    """

    uv: Tensor
    xyz_m: Tensor


class DecodedMesh(NamedTuple):
    """What a latent says about the shape.

    Attributes:
        vertices_m: The mesh to draw, on the topology that the model names, ``[N, V, 3]``.
        tracked_m: The same surface at the vertices of the tracked topology, ``[N, Vt, 3]``.
        position_map_m: The map that both were sampled from, ``[N, 3, S, S]``; None where the model
            decodes vertices directly.
    """

    vertices_m: Tensor
    tracked_m: Tensor
    position_map_m: Tensor | None


class LinearPrior(NamedTuple):
    """What the closed form found of a capture.

    Attributes:
        tracked: Bases of the tracked mesh, for the same weights as `parts`.
        parts: Bases of the dense mesh, by regions.
        texels: Texels of the position map that the encoder reads, row * S + column, ``[P]``.
        projection: From their three coordinates to the weights, in position scales, ``[K, 3 P]``.
        deviation_m: Root mean square movement of each basis, ``[K]``.
    """

    tracked: Bases
    parts: SplitBases
    texels: IntArray
    projection: FloatArray
    deviation_m: FloatArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FacePrior:
    """What a model is told about a person before it is trained."""

    position_mean: FloatArray
    """Mean position map, head frame, metres, float32 ``[S, S, 3]``."""
    tracked_position_mean: FloatArray
    """The same of the tracked mesh, which may cover other texels, float32 ``[S, S, 3]``."""
    position_scale_m: float
    """Unit of decoded offsets from the mean, metres."""
    dense_uv: FloatArray
    """UVs of the dense topology's vertices, float32 ``[V, 2]``."""
    tracked_uv: FloatArray
    """UVs of the tracked topology's vertices, float32 ``[Vt, 2]``."""
    tracked_mean_m: FloatArray
    """Mean tracked mesh, metres, float32 ``[Vt, 3]``."""
    texture_mean: FloatArray
    """Mean of the average textures, sRGB with 1.0 for 255, row 0 is v = 0, float32 ``[T, T, 3]``.
    """
    linear: LinearPrior | None = None
    """Bases of the meshes; None where no model asks for them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ModelOptions:
    """What is built beside an `AvatarSpec`."""

    encoder: str = "light"
    """"paper" (161.7 G multiply-adds a frame) or "light"."""
    encoding_amplitude: float = 0.1
    """Half-width of the encodings' uniform start; 1 in the paper. Smaller leaves less noise in
    texels that few images saw."""
    texture_contrast: float = 0.3
    """Begin m_uv with the mean texture, black and white at minus and plus this; 0 for a uniform
    start, as the paper."""
    texture_size: int = 512
    """Rows and columns of the baseline's texture; 1024 in the paper."""


LID_BENDS: tuple[tuple[dict[str, float], tuple[float, ...]], ...] = (
    ({"eyeBlink": 1.0}, (0.2, 0.4, 0.6, 0.8)),
    ({"eyeBlink": 1.0, "eyeLookDown": 0.5, "eyeSquint": 0.3}, (0.2, 0.4, 0.6, 0.8, 1.0, 1.2)),
    ({"eyeBlink": 1.0, "eyeLookDown": 1.0}, (0.3, 0.6, 0.9, 1.2)),
    ({"eyeBlink": 1.0, "eyeLookUp": 1.0}, (0.3, 0.6, 0.9)),
    ({"eyeBlink": 1.0, "eyeLookUp": -1.0}, (0.1, 0.3, 0.5)),
    ({"eyeBlink": 1.0, "eyeSquint": 1.0}, (0.3, 0.6, 0.9)),
    ({"eyeLookDown": 1.0}, (0.3, 0.6)),
    ({"eyeSquint": 1.0}, (0.3,)),
)
"""Sums of an eye's shapes, and where along each of them the live encoder bends: lids slide around
eyeballs, which no straight line follows (chosen among five such lists on one person)."""


def _bends() -> tuple[Tensor, Tensor]:
    """Sums of shapes ``[B, 52]`` and where they bend, ``[B]``; the last is the line on which lips
    that close meet the jaw that opens."""
    sums: list[Tensor] = []
    places: list[float] = []
    for shapes, bends in LID_BENDS:
        for side in ("Left", "Right"):
            row = torch.zeros(NUM_ARKIT)
            for name, weight in shapes.items():
                row[ARKIT_INDEX[name + side]] = weight
            sums += [row] * len(bends)
            places += bends
    lips = torch.zeros(NUM_ARKIT)
    lips[ARKIT_INDEX["mouthClose"]], lips[ARKIT_INDEX["jawOpen"]] = 1.0, -1.0
    return torch.stack([*sums, lips]), torch.tensor([*places, 0.0])


class ExpressionEncoder(nn.Module):
    """52 ARKit values to the latent: the sender's encoder, small enough for any CPU (ours)."""

    def __init__(self) -> None:
        super().__init__()
        widths = pairwise((NUM_ARKIT, *ENCODER_CHANNELS))
        self.layers = nn.ModuleList(nn.Linear(n, m) for n, m in widths)

    @torch.no_grad()
    def start_from(self, matrix: Tensor, offset: Tensor) -> None:
        """Become latent = matrix . lifted(arkit) + offset, ``[256, 52 + B]`` and ``[256]``, flat.

        A pair of units passes each value on, once with either sign: the difference of the two is
        1 + slope times the value; one unit each bends. Others stay random, and silent at the end.
        """
        first, second, last = (layer for layer in self.layers if isinstance(layer, nn.Linear))
        both = 2 * NUM_ARKIT
        eye, gain = torch.eye(NUM_ARKIT), 1 / (1 + LEAKY_SLOPE)
        first.weight[:both], first.bias[:both] = torch.cat([eye, -eye]), 0
        passed = gain * torch.cat([torch.cat([eye, -eye], 1), torch.cat([-eye, eye], 1)])
        second.weight[:both], second.bias[:both] = 0, 0
        second.weight[:both, :both] = passed
        sums, places = _bends()
        bent = slice(both, both + len(sums))
        first.weight[bent], first.bias[bent] = sums, -places
        second.weight[bent], second.bias[bent] = 0, 0
        second.weight[bent, bent] = torch.eye(len(sums))
        last.weight.zero_()
        plain = matrix[:, :NUM_ARKIT]
        last.weight[:, :both] = gain * torch.cat([plain, -plain], 1)
        last.weight[:, bent] = matrix[:, NUM_ARKIT:]
        last.bias.copy_(offset)

    @staticmethod
    def lifted(arkit: Tensor) -> Tensor:
        """Expressions ``[N, 52]``, and after them their sums that bend, ``[N, 52 + B]``."""
        sums, places = (values.to(arkit) for values in _bends())
        beyond = arkit @ sums.T - places
        return torch.cat([arkit, torch.where(beyond > 0, beyond, LEAKY_SLOPE**2 * beyond)], 1)

    def forward(self, arkit: Tensor) -> Tensor:
        """Expressions ``[N, 52]`` to latents ``[N, 4, 8, 8]``; flat: row, column, channel."""
        values = arkit
        for index, layer in enumerate(self.layers):
            values = layer(values)
            if index + 1 < len(self.layers):
                values = nn.functional.leaky_relu(values, LEAKY_SLOPE)
        return grid_of_latent(values)


class LatentEncoder(nn.Module, ABC):
    """Average texture and tracked mesh of a moment to the latent."""

    texture_size: int
    """Rows and columns of the textures that it takes."""

    @abstractmethod
    def forward(self, texture: Tensor, position_map: Tensor) -> tuple[Tensor, Tensor]:
        """Encode a batch.

        Args:
            texture: Average texture, centred and scaled to about [-1, 1],
                ``[N, 3, texture_size, texture_size]``.
            position_map: Tracked mesh as a map, offsets from the mean in units of the position
                scale, ``[N, 3, S, S]``.

        Returns:
            Mean and log-variance, ``[N, 4, 8, 8]`` each.
        """


class AvatarModel(nn.Module, ABC):
    """Base of all models. What is not abstract here is the same for all of them."""

    spec: AvatarSpec
    encoder: LatentEncoder
    expression_encoder: ExpressionEncoder
    topology: TopologyName
    """Which mesh of the capture `DecodedMesh.vertices_m` lies on."""

    @abstractmethod
    def decode_mesh(self, latent: Tensor) -> DecodedMesh:
        """Latents ``[N, 4, 8, 8]`` to meshes; differentiable."""

    @abstractmethod
    def appearance(self, latent: Tensor, view_direction: Tensor) -> Tensor:
        """What `shade` needs beside the surface, made once for an image.

        Args:
            latent: ``[N, 4, 8, 8]``.
            view_direction: From the head to the camera, unit length, ``[N, 3]``.

        Returns:
            Maps over UV, ``[N, C, S, S]``: expression codes, or a whole texture.
        """

    @abstractmethod
    def shade(self, appearance: Tensor, surface: Surface) -> Tensor:
        """Colours of the pixels of `surface`: sRGB, 1.0 is 255, not clamped, ``[N, K, 3]``.

        No gradient goes from the colour to the geometry through a pixel decoder's xyz input, for
        stable training (paper A.3); the other path, through rasterisation to uv, stays open.

        Args:
            appearance: From `appearance`, of all images.
            surface: The pixels.
        """

    @property
    @abstractmethod
    def cost(self) -> ModelCost:
        """What a receiver pays to run it."""

    @abstractmethod
    def parameter_groups(self) -> ParameterGroups:
        """All trainable weights but the expression encoder's, each in one group.

        "shape" holds the latent encoder and what decodes meshes, "appearance" what decodes maps
        over UV, "pixel" the small networks that run per pixel, "encoding" tables whose entries each
        see few pixels and bear larger steps. A group may be empty.
        """

    def vertices(self, latent: Tensor) -> Tensor:
        """Vertices to draw, metres, ``[N, V, 3]``."""
        return self.decode_mesh(latent).vertices_m


def grid_of_latent(values: Tensor) -> Tensor:
    """Flat latents ``[N, 256]``, ordered row, column, channel, as ``[N, 4, 8, 8]``."""
    return values.view(-1, LATENT_SIZE, LATENT_SIZE, LATENT_CHANNELS).permute(0, 3, 1, 2)


def flat_latent(grid: Tensor) -> Tensor:
    """`grid_of_latent` reversed: ``[N, 4, 8, 8]`` to ``[N, 256]``."""
    return grid.permute(0, 2, 3, 1).reshape(-1, NUM_LATENT)


def uv_buffer(uv: FloatArray) -> Tensor:
    """Vertex UVs as a tensor of its own, float32 ``[V, 2]``."""
    return torch.tensor(np.asarray(uv), dtype=torch.float32)
