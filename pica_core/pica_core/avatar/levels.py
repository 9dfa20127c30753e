"""Levels of detail: which maps an avatar can be decoded to, and what each of them costs in error.

A *level* is the size of the decoded expression map in texels per side. The full one is the model
itself. A level below it is an early exit of both decoders: the trunk is left after the block that
makes maps of that size, and one linear layer turns what is there into

    expression map = conv3x3(trunk) + bias                       a bias per texel, [S, S, 4]
    vertices       = mean + position_scale_m * (weight . trunk)  weights per vertex, in a sheet

The vertices are those of the level's own mesh: coarser triangles over some of the same vertices.
Each is made of the two texels of the trunk that are nearest to it. A position map of that size
would not do: lids and lips lie closer together than its texels, and with one convolution for all
of it eyes and lips do not follow (vertices 0.27 mm off on average in a face that moves by 0.86;
0.05 mm like this). The mesh of a level can also be drawn with the full maps.

An avatar may have exits at a quarter and a half of its full map: 64 and 128 of 256.

Tensors of an avatar file: all of them may be absent; float32 in memory unless stated. S is a level
below the full one, C the channels of the trunk there, R the rows that hold the vertices of its
mesh, T is 1 to 4.

    level.{S}.faces              [F, 3] int32, over mesh.vertex_uv
    level.{S}.geometry.mean      [R, S, 3] metres
    level.{S}.geometry.texel     [R, S, T] int32: which texels of the trunk, row * S + column
    level.{S}.geometry.weight    [R, S, 3 * C * T]: of x, of its first channel, of the first texel
    level.{S}.expression.weight  [4, C, 3, 3]
    level.{S}.expression.bias    [4, S, S]
    level.{S}.expression.local   [S / 2, S / 2, 4 * C]: for each block of 2 x 2 texels, weights of
                                 its own over the trunk's channels there, added to the convolution;
                                 of the first code, of the first channel; may be absent alone
    level.still                  [8, 8, 4]: the latent whose full expression map, seen from the
                                 front, is added to what levels below the full one make

Where bases make the vertices (`linear`), a level has no ``geometry`` tensors: its sheet holds the
same bases' vertices.

A level is there as a whole or not at all; without ``level.still`` nothing is added. The geometry is
a *sheet*: the k-th vertex that the level's mesh uses, counted from the lowest number, stands in row
k // S and column k % S. What is left of the last row belongs to no vertex.
"""

from collections.abc import Iterable, Mapping

import numpy as np

from pica_core.avatar.decoder_layers import trunk_channels
from pica_core.avatar.linear import RANK
from pica_core.avatar.spec import POSITION_CHANNELS, AvatarSpec
from pica_core.latent import LATENT_SHAPE, LATENT_SIZE
from pica_core.types import Array, FloatArray

EXIT_DIVISORS = (4, 2)
"""Full map size over the size of each possible exit (chosen: the two last blocks are where the
work of a decoder is)."""


def level_sizes(spec: AvatarSpec) -> tuple[int, ...]:
    """Every level that an avatar of this spec may have, ascending; the full map is the last."""
    sizes = [spec.map_size // divisor for divisor in EXIT_DIVISORS]
    return (*(size for size in sizes if size > LATENT_SIZE), spec.map_size)


PREFIX = "level."
MAX_TEXELS = 4
"""Most texels of the trunk that a vertex is made of."""
LOCAL_TEXELS = 2
"""Side of a block of texels with weights of its own (measured: docs/architecture.md)."""
STILL_NAME = PREFIX + "still"


def is_faces(name: str) -> bool:
    """Whether a tensor of an avatar holds triangles."""
    return name == "mesh.faces" or (name.startswith(PREFIX) and name.endswith(".faces"))


def is_index(name: str) -> bool:
    """Whether a tensor of an avatar holds whole numbers: triangles, texels of a trunk, or ranks."""
    is_texel = name.startswith(PREFIX) and name.endswith(".geometry.texel")
    return name == RANK or is_faces(name) or is_texel


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


def exit_shapes(
    spec: AvatarSpec, level: int, rows: int, num_texels: int
) -> dict[str, tuple[int, ...]]:
    """Name and shape of the tensors that make an exit, its mesh excepted: of the rows of its sheet,
    and with so many texels of the trunk to a vertex."""
    channels, prefix = trunk_channels(spec, level), f"{PREFIX}{level}"
    codes = spec.expression_channels
    expression: dict[str, tuple[int, ...]] = {
        f"{prefix}.expression.weight": (codes, channels, 3, 3),
        f"{prefix}.expression.bias": (codes, level, level),
    }
    if spec.geometry == "bases":
        return expression
    return {
        f"{prefix}.geometry.weight": (rows, level, POSITION_CHANNELS * channels * num_texels),
        f"{prefix}.geometry.mean": (rows, level, POSITION_CHANNELS),
        f"{prefix}.geometry.texel": (rows, level, num_texels),
        **expression,
    }


def levels_of(spec: AvatarSpec, names: Iterable[str]) -> tuple[int, ...]:
    """The levels of an avatar with tensors of these names, ascending; the full one is the last."""
    there = set(names)
    exits = level_sizes(spec)[:-1]
    found = (size for size in exits if there.intersection(exit_shapes(spec, size, 1, 1)))
    return (*found, spec.map_size)


def wanted_shapes(
    spec: AvatarSpec, shapes: Mapping[str, tuple[int, ...]], max_faces: int
) -> dict[str, tuple[int, ...]]:
    """Shapes that the ``level.*`` tensors of a file must have, judged by which of them it has;
    ValueError if a number of triangles is out of its limits. Unknown names are left to
    the caller."""

    def rows(name: str, limit: int) -> int:
        count = (*shapes.get(name, (1,)), 0)[0]
        if not 1 <= count <= limit:
            raise ValueError(f"tensor {name} has {count} rows; allowed are 1 to {limit}")
        return count

    levels = levels_of(spec, shapes)
    wanted: dict[str, tuple[int, ...]] = {}
    for size in level_sizes(spec)[:-1]:
        faces, sheet = faces_name(size), f"{PREFIX}{size}.geometry"
        if size in levels or faces in shapes:
            num_texels = (1, *shapes.get(f"{sheet}.texel", ()))[-1]
            num_texels = min(max(num_texels, 1), MAX_TEXELS)
            num_rows = 1
            if spec.geometry == "decoder":
                num_rows = rows(f"{sheet}.mean", sheet_rows(3 * max_faces, size))
            wanted |= exit_shapes(spec, size, num_rows, num_texels)
            wanted[faces] = (rows(faces, max_faces), 3)
            if local_name(size) in shapes:
                wanted[local_name(size)] = local_shape(spec, size)
    if STILL_NAME in shapes:
        wanted[STILL_NAME] = LATENT_SHAPE
    return wanted


def check_sheets(spec: AvatarSpec, tensors: Mapping[str, Array]) -> None:
    """Compare the sheets of an avatar's levels with their meshes; names and shapes fit already.
    ValueError if a sheet has more or fewer rows than its vertices need, or a vertex is made of a
    texel that is not there."""
    exits = levels_of(spec, tensors)[:-1] if spec.geometry == "decoder" else ()
    for level in exits:
        mean, texel = (f"{PREFIX}{level}.geometry.{name}" for name in ("mean", "texel"))
        num_vertices = len(np.unique(tensors[faces_name(level)]))
        rows = sheet_rows(num_vertices, level)
        if len(tensors[mean]) != rows:
            raise ValueError(
                f"tensor {mean} has {len(tensors[mean])} rows; the {num_vertices} "
                f"vertices of {faces_name(level)} need {rows}"
            )
        check_indices(texel, tensors[texel], level * level, "texels")


def check_indices(name: str, indices: Array, count: int, what: str) -> None:
    """Raise a ValueError that names the tensor whose indices do not all lie below a count."""
    low, high = indices.min(), indices.max()
    if low < 0 or high >= count:
        raise ValueError(
            f"tensor {name} names {what} {low} to {high}; allowed are 0 to {count - 1}"
        )
