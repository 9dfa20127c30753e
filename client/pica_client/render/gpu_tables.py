"""The numbers of an avatar's decoders, laid out for the shaders that evaluate them. Pure.

Shaders compute four channels at once, so weights are 4x4 blocks of four texels: the texel of an
input channel holds what it adds to each of four outputs. Channels are padded with zeros to
multiples of four. All avatars of one `Plan` have their numbers at the same places, in two tables:
one of 16-bit floats, for what avatar files store with no more, and one of 32-bit floats.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pica_core.avatar.decoder_layers import decoder_layers
from pica_core.avatar.file import Avatar
from pica_core.avatar.level_tensors import local_name
from pica_core.avatar.linear import PREFIX, RANK, REGION
from pica_core.avatar.spec import AvatarSpec
from pica_core.latent import NUM_LATENT
from pica_core.types import Array, FloatArray

VECTOR = 4
TABLE_COLUMNS = 1024
"""Texels in a row of a table: a power of two that every driver has."""
SNORM = 127
"""Bases of avatar files are multiples of one part in so many: they fit signed bytes."""


def vectors(channels: int) -> int:
    """Texels of four that so many channels fill."""
    return -(-channels // VECTOR)


@dataclass(frozen=True, kw_only=True, slots=True)
class Pass:
    """One step of the expression decoder, for all heads at once."""

    shader: str
    """File of its fragment shader."""
    size: int
    """Rows and columns of what it reads."""
    in_vectors: int
    out_vectors: int
    weights: int
    """Where its weights begin in their table, texels."""
    bias: int
    """Where its biases begin: one for each texel of a convolution, one for each phase of an
    expansion."""
    local: int | None = None
    """Where the weights of each block of 2 x 2 texels begin, if there are some."""
    is_exact: bool = False
    """Whether its numbers stand in the table of 32-bit floats."""
    is_leaky: bool = True
    is_first: bool = False
    """Whether it reads latents and view directions."""
    multiply_adds: int = 0

    @property
    def tile(self) -> int:
        """Rows and columns of each phase of its output."""
        return self.size if self.shader == "decode_expand.frag" else self.size // 2

    @property
    def defines(self) -> dict[str, str]:
        """What its shader is told."""
        found = {
            "SIZE": str(self.size),
            "IN_VECTORS": str(self.in_vectors),
            "WEIGHTS": str(self.weights),
            "BIAS": str(self.bias),
            "LEAK": "0.2" if self.is_leaky else "1.0",
        }
        if self.local is not None:
            found["LOCAL"] = str(self.local)
        if self.is_first:
            found["FIRST"] = ""
        return found


@dataclass(frozen=True, kw_only=True, slots=True)
class Plan:
    """Where the numbers of alike avatars stand, and the steps that use them."""

    trunk: tuple[Pass, ...]
    """The steps to the full expression map, two for each block."""
    exits: Mapping[int, Pass]
    """What is done instead of the remaining steps at a level below, after `trunk_length` of
    them."""
    num_bases: int
    bases_weight: int
    bases_bias: int
    mix: int

    @property
    def shaders(self) -> dict[str, tuple[str, dict[str, str]]]:
        """File and defines of all fragment shaders."""
        steps = {f"trunk {number}": step for number, step in enumerate(self.trunk)}
        steps |= {f"exit {level}": step for level, step in self.exits.items()}
        bases = {"IN_VECTORS": vectors(NUM_LATENT), "WEIGHTS": self.bases_weight}
        bases["BIAS"] = self.bases_bias
        mix = {"IN_VECTORS": vectors(self.num_bases), "WEIGHTS": self.mix}
        levels = (*self.exits, 2 * self.trunk[-1].tile)
        return {
            **{name: (step.shader, step.defines) for name, step in steps.items()},
            **{f"gather {level}": ("decode_gather.frag", {"SIZE": str(level)}) for level in levels},
            "bases": ("decode_dense.frag", {name: str(value) for name, value in bases.items()}),
            "mix": ("decode_dense.frag", {name: str(value) for name, value in mix.items()}),
            "sheet": ("decode_sheet.frag", {}),
        }

    def trunk_length(self, level: int) -> int:
        """How many steps of the trunk a level takes."""
        if level not in self.exits:
            return len(self.trunk)
        return next(number for number, step in enumerate(self.trunk) if step.size == level)

    def multiply_adds(self, level: int) -> int:
        """Work of a level's expression map."""
        steps = [*self.trunk[: self.trunk_length(level)]]
        steps += [self.exits[level]] if level in self.exits else []
        return sum(step.multiply_adds for step in steps)


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """One avatar's numbers, ``[rows, TABLE_COLUMNS, 4]`` each."""

    half: Array
    """float16."""
    exact: FloatArray
    """float32."""


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """What the vertices of one level are made of."""

    mean_m: FloatArray
    """float32 ``[R, S, 3]``."""
    places: Array
    """The column of each vertex in `basis`, and the first and the one after the last of its rows
    there. uint16 ``[R, S, 3]``."""


class _Table:
    """Texels that are added one after the other."""

    def __init__(self) -> None:
        self.parts: list[Array] = []
        self.length = 0

    def add(self, texels: Array) -> int:
        """Add texels ``[..., 4]``; where they begin."""
        start = self.length
        self.parts.append(texels.reshape(-1, VECTOR))
        self.length += len(self.parts[-1])
        return start

    def rows(self) -> Array:
        """All of them, in rows."""
        rows = -(-self.length // TABLE_COLUMNS)
        found = np.zeros((rows * TABLE_COLUMNS, VECTOR), np.float32)
        found[: self.length] = np.concatenate(self.parts)
        return found.reshape(rows, TABLE_COLUMNS, VECTOR)


def lay_out(avatar: Avatar) -> tuple[Plan, Tables] | None:
    """An avatar's plan and numbers; None if shaders do not evaluate such avatars: those of another
    block, those without bases, and those with more exact numbers than files hold."""
    spec, tensors = avatar.spec, avatar.tensors
    if spec.block != "G" or spec.geometry != "bases":
        return None
    half, exact = _Table(), _Table()
    trunk: list[Pass] = []
    layers = {layer.name: layer for layer in decoder_layers(spec, "expression")}
    for index in range(len(spec.hidden_channels) + 1):
        name = f"expression.{index}"
        first, expand = layers[f"{name}.first"], layers[f"{name}.expand"]
        trunk.append(
            Pass(
                shader="decode_convolve.frag",
                size=first.size,
                in_vectors=vectors(first.in_channels),
                out_vectors=vectors(first.out_channels),
                weights=half.add(_kernels(tensors[f"{name}.first.weight"])),
                bias=half.add(_texels(tensors[f"{name}.first_bias.weight"])),
                is_first=index == 0,
                multiply_adds=first.multiply_adds,
            )
        )
        trunk.append(
            Pass(
                shader="decode_expand.frag",
                size=expand.size,
                in_vectors=vectors(expand.in_channels),
                out_vectors=vectors(expand.out_channels // 4),
                weights=half.add(_phases(tensors[f"{name}.expand.weight"])),
                bias=half.add(_phase_biases(tensors[f"{name}.expand.bias"])),
                is_leaky=index < len(spec.hidden_channels),
                multiply_adds=expand.multiply_adds,
            )
        )
    exits = {level: _exit(spec, tensors, level, exact) for level in avatar.levels[:-1]}
    weight = tensors[f"{PREFIX}weight"]
    plan = Plan(
        trunk=tuple(trunk),
        exits=exits,
        num_bases=len(weight),
        bases_weight=exact.add(_blocks(weight)),
        bases_bias=exact.add(_padded(tensors[f"{PREFIX}bias"], 0)),
        # Last: only these differ in number between avatars of one plan.
        mix=half.add(_blocks(tensors[f"{PREFIX}mix"])),
    )
    rows = half.rows()
    small = rows.astype(np.float16)
    if not np.array_equal(small, rows):
        return None
    return plan, Tables(small, exact.rows())


def sheet_of(avatar: Avatar, level: int) -> Sheet:
    """What a level's vertices are made of."""
    vertex = avatar.sheet_places(level)
    ends = np.cumsum(avatar.tensors[RANK])
    starts = ends - avatar.tensors[RANK]
    region = vertex // REGION
    places = np.stack([vertex % REGION, starts[region], ends[region]], axis=1)
    shape = (-1, level, 3)
    mean = avatar.tensors[f"{PREFIX}mean"].reshape(-1, 3)[vertex]
    return Sheet(
        np.ascontiguousarray(mean.reshape(shape), np.float32),
        np.ascontiguousarray(places.reshape(shape), np.uint16),
    )


def basis_of(avatar: Avatar) -> Array:
    """The directions of all regions ``[L, REGION, 3]``: signed bytes where those hold them, else
    float32."""
    basis: FloatArray = avatar.tensors[f"{PREFIX}basis"]
    codes = np.rint(basis * SNORM)
    is_coarse = np.allclose(codes / SNORM, basis, rtol=0, atol=1e-6)
    return codes.astype(np.int8) if is_coarse else basis


def _exit(spec: AvatarSpec, tensors: Mapping[str, Array], level: int, exact: _Table) -> Pass:
    weight = tensors[f"level.{level}.expression.weight"]
    num_codes, channels = weight.shape[:2]
    own = tensors.get(local_name(level))
    local = None
    if own is not None:
        shape = (*own.shape[:2], num_codes, channels)
        spread = _padded(_padded(own.reshape(shape), 2), 3)
        spread = spread.reshape(*own.shape[:2], vectors(num_codes), VECTOR, -1, VECTOR)
        local = exact.add(spread.transpose(2, 0, 1, 4, 5, 3))
    return Pass(
        shader="decode_convolve.frag",
        size=level,
        in_vectors=vectors(channels),
        out_vectors=vectors(num_codes),
        weights=exact.add(_kernels(weight)),
        bias=exact.add(_texels(tensors[f"level.{level}.expression.bias"])),
        local=local,
        is_exact=True,
        is_leaky=False,
        multiply_adds=(9 + (local is not None)) * channels * num_codes * level * level,
    )


def _padded(array: Array, axis: int) -> Array:
    """With zeros up to the next multiple of `VECTOR` along an axis."""
    edges = [(0, 0)] * array.ndim
    edges[axis] = (0, -array.shape[axis] % VECTOR)
    return np.pad(array, edges)


def _blocks(weight: Array) -> Array:
    """A matrix ``[out, in]`` as ``[out / 4, in / 4, 4 inputs, 4 outputs]``."""
    padded = _padded(_padded(weight, 0), 1)
    tiles = padded.reshape(len(padded) // VECTOR, VECTOR, -1, VECTOR)
    return tiles.transpose(0, 2, 3, 1)


def _kernels(weight: Array) -> Array:
    """A 3x3 convolution ``[out, in, 3, 3]`` as ``[out / 4, in / 4, 3, 3, 4 inputs, 4 outputs]``."""
    padded = _padded(_padded(weight, 0), 1)
    tiles = padded.reshape(len(padded) // VECTOR, VECTOR, -1, VECTOR, 3, 3)
    return tiles.transpose(0, 2, 4, 5, 3, 1)


def _texels(bias: Array) -> Array:
    """A bias of each texel ``[C, S, S]`` as ``[C / 4, S, S, 4]``."""
    padded = _padded(bias, 0)
    return padded.reshape(-1, VECTOR, *bias.shape[1:]).transpose(0, 2, 3, 1)


def _phases(weight: Array) -> Array:
    """An expansion ``[4 C, in, 1, 1]`` as ``[C / 4, in / 4, 4 phases, 4 inputs, 4 outputs]``;
    channel 4 c + p becomes phase p of channel c."""
    channels = len(weight) // VECTOR
    padded = _padded(_padded(weight.reshape(channels, VECTOR, -1), 0), 2)
    tiles = padded.reshape(len(padded) // VECTOR, VECTOR, VECTOR, -1, VECTOR)
    return tiles.transpose(0, 3, 2, 4, 1)


def _phase_biases(bias: Array) -> Array:
    """Its bias ``[4 C]`` as ``[C / 4, 4 phases, 4]``."""
    padded = _padded(bias.reshape(-1, VECTOR), 0)
    return padded.reshape(-1, VECTOR, VECTOR).transpose(0, 2, 1)
