"""Levels of detail: which maps an avatar can be decoded to.

A *level* is the size of the decoded expression map in texels per side. The full one is the model
itself. A level below it is an early exit: the trunk of the expression decoder is left after the
block that makes maps of that size, and one linear layer turns what is there into

    expression map = conv3x3(trunk) + bias              a bias per texel, [S, S, 4]

Its mesh is its own: coarser triangles over some of the same vertices, which the same bases make
(`linear`). The mesh of a level can also be drawn with the full maps. An avatar may have exits at a
quarter and a half of its full map, 64 and 128 of 256; one whose geometry is decoded has none.

Tensors of an avatar file: all of them may be absent; float32 in memory unless stated. S is a level
below the full one, C the channels of the trunk there.

    level.{S}.faces              [F, 3] int32, over mesh.vertex_uv
    level.{S}.expression.weight  [4, C, 3, 3]
    level.{S}.expression.bias    [4, S, S]
    level.{S}.expression.local   [S / 2, S / 2, 4 * C]: for each block of 2 x 2 texels, weights of
                                 its own over the trunk's channels there, added to the convolution;
                                 of the first code, of the first channel; may be absent alone
    level.still                  [8, 8, 4]: the latent whose full expression map, seen from the
                                 front, is added to what levels below the full one make

A level is there as a whole or not at all; without ``level.still`` nothing is added. Vertices of a
level stand in a *sheet*: the k-th vertex that its mesh uses, counted from the lowest number, stands
in row k // S and column k % S. What is left of the last row belongs to no vertex.
"""

from collections.abc import Iterable, Mapping

import numpy as np

from pica_core.avatar.linear import RANK
from pica_core.avatar.spec import AvatarSpec, trunk_channels
from pica_core.latent import LATENT_SHAPE, LATENT_SIZE
from pica_core.types import Array, FloatArray

EXIT_DIVISORS = (4, 2)
"""Full map size over the size of each possible exit (chosen: the two last blocks are where the
work of a decoder is)."""


def level_sizes(spec: AvatarSpec) -> tuple[int, ...]:
    """Every level that an avatar of this spec may have, ascending; the full map is the last."""
    if spec.geometry != "bases":
        return (spec.map_size,)
    sizes = [spec.map_size // divisor for divisor in EXIT_DIVISORS]
    return (*(size for size in sizes if size > LATENT_SIZE), spec.map_size)


PREFIX = "level."
LOCAL_TEXELS = 2
"""Side of a block of texels with weights of its own (measured: docs/architecture.md)."""
STILL_NAME = PREFIX + "still"


def is_faces(name: str) -> bool:
    """Whether a tensor of an avatar holds triangles."""
    return name == "mesh.faces" or (name.startswith(PREFIX) and name.endswith(".faces"))


def is_index(name: str) -> bool:
    """Whether a tensor of an avatar holds whole numbers: triangles or ranks."""
    return name == RANK or is_faces(name)


def sheet_rows(num_vertices: int, level: int) -> int:
    """Rows of the sheet that holds so many vertices."""
    return -(-num_vertices // level)


def sheet_uv(num_vertices: int, level: int) -> FloatArray:
    """Where vertices stand in their sheet, as texture coordinates. float32 ``[V, 2]``."""
    number, rows = np.arange(num_vertices), sheet_rows(num_vertices, level)
    across, down = (number % level + 0.5) / level, (number // level + 0.5) / rows
    places: FloatArray = np.stack([across, down], axis=1).astype(np.float32)
    return places


def faces_name(level: int) -> str:
    """Name of a level's own triangles."""
    return f"{PREFIX}{level}.faces"


def local_name(level: int) -> str:
    """Name of the weights that each block of texels of a level's map has of its own."""
    return f"{PREFIX}{level}.expression.local"


def local_shape(spec: AvatarSpec, level: int) -> tuple[int, int, int]:
    """Shape of those weights."""
    side = level // LOCAL_TEXELS
    return side, side, spec.expression_channels * trunk_channels(spec, level)


def spread_local(local: Array, num_codes: int) -> Array:
    """Those weights for every texel, ``[num_codes, C, S, S]``."""
    own = local.repeat(LOCAL_TEXELS, axis=0).repeat(LOCAL_TEXELS, axis=1)
    return own.reshape(*own.shape[:2], num_codes, -1).transpose(2, 3, 0, 1)


def exit_shapes(spec: AvatarSpec, level: int) -> dict[str, tuple[int, ...]]:
    """Name and shape of the tensors that make an exit, its mesh excepted."""
    codes, prefix = spec.expression_channels, f"{PREFIX}{level}.expression"
    return {
        f"{prefix}.weight": (codes, trunk_channels(spec, level), 3, 3),
        f"{prefix}.bias": (codes, level, level),
    }


def levels_of(spec: AvatarSpec, names: Iterable[str]) -> tuple[int, ...]:
    """The levels of an avatar with tensors of these names, ascending; the full one is the last."""
    there = set(names)
    exits = level_sizes(spec)[:-1]
    found = (size for size in exits if there.intersection(exit_shapes(spec, size)))
    return (*found, spec.map_size)


def wanted_shapes(
    spec: AvatarSpec, shapes: Mapping[str, tuple[int, ...]], max_faces: int
) -> dict[str, tuple[int, ...]]:
    """Shapes that the ``level.*`` tensors of a file must have, judged by which of them it has;
    ValueError if a number of triangles is out of its limits. Unknown names are left to
    the caller."""

    levels = levels_of(spec, shapes)
    wanted: dict[str, tuple[int, ...]] = {}
    for size in level_sizes(spec)[:-1]:
        faces = faces_name(size)
        if size in levels or faces in shapes:
            count = (*shapes.get(faces, (1,)), 0)[0]
            if not 1 <= count <= max_faces:
                raise ValueError(f"tensor {faces} has {count} rows; allowed are 1 to {max_faces}")
            wanted |= exit_shapes(spec, size) | {faces: (count, 3)}
            if local_name(size) in shapes:
                wanted[local_name(size)] = local_shape(spec, size)
    if STILL_NAME in shapes:
        wanted[STILL_NAME] = LATENT_SHAPE
    return wanted


def check_indices(name: str, indices: Array, count: int, what: str) -> None:
    """Raise a ValueError that names the tensor whose indices do not all lie below a count."""
    low, high = indices.min(), indices.max()
    if low < 0 or high >= count:
        raise ValueError(
            f"tensor {name} names {what} {low} to {high}; allowed are 0 to {count - 1}"
        )
