"""Levels of detail: which maps an avatar can be decoded to.

A *level* is the size of the decoded expression map in texels per side. The full one is the model
itself. A level below it is an early exit: the trunk of the expression decoder is left after the
block that makes maps of that size, and one linear layer turns what is there into

    expression map = conv3x3(trunk) + bias              a bias per texel, [S, S, 4]

Its mesh is its own: coarser triangles over some of the same vertices, which the same bases make
(`linear`). An avatar has exits at 64 and 128 of 256 or none; one whose geometry is decoded has
none.

Tensors of an avatar file with levels, all of them; float32 in memory unless stated. S is a level
below the full one, C the channels of the trunk there.

    level.{S}.faces              [F, 3] int32, over mesh.vertex_uv
    level.{S}.expression.weight  [4, C, 3, 3]
    level.{S}.expression.bias    [4, S, S]
    level.{S}.expression.local   [S / 2, S / 2, 4 * C]: for each block of 2 x 2 texels, weights of
                                 its own over the trunk's channels there, added to the convolution;
                                 first code, first channel first; at 64 alone
    level.still                  [8, 8, 4]: the latent whose full expression map, seen from the
                                 front, is added to what levels below the full one make

Vertices of a level stand in a *sheet*: the k-th vertex that its mesh uses, counted from the lowest
number, stands in row k // S and column k % S. What is left of the last row belongs to no vertex.

Static surfaces: what of a head looks the same whatever the face does, such as a pullover.

A receiver draws these parts with a texture in place of the pixel decoder. The file holds no texture
and no mesh of them, only which vertices are static: the texture is the pixel decoder's colour of
the still face (``level.still``, seen from the front, the mesh at rest), and the triangles are those
of the level that is drawn.

    static.parts    [ceil(V / 4)] uint8: two bits a vertex of the mesh, the lowest first

        0  MOVING   decoded
        1  SEAM     decoded, and where the texture begins: transparent
        2  STATIC   textured, opaque; 3 means the same

A triangle with a corner that is not static is decoded; one without a moving corner is textured.
Where both are drawn the texture gives way from its static corners to those of the seam. So every
level is covered, whatever the bits are.
"""

from collections.abc import Mapping

import numpy as np

from pica_core.avatar.linear import RANK
from pica_core.avatar.spec import EXPRESSION_CHANNELS, MAP_SIZE, AvatarSpec, trunk_layers
from pica_core.types import LATENT_SHAPE, Array, ByteArray, FloatArray, IntArray

EXIT_SIZES = (MAP_SIZE // 4, MAP_SIZE // 2)
"""Levels below the full one (chosen: the two last blocks are where the work of a decoder is)."""
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
    return np.stack([across, down], axis=1).astype(np.float32)


def faces_name(level: int) -> str:
    """Name of a level's own triangles."""
    return f"{PREFIX}{level}.faces"


def local_name(level: int) -> str:
    """Name of the weights that each block of texels of a level's map has of its own."""
    return f"{PREFIX}{level}.expression.local"


def spread_local(local: Array) -> Array:
    """Those weights for every texel, ``[4, C, S, S]``."""
    own = local.repeat(LOCAL_TEXELS, axis=0).repeat(LOCAL_TEXELS, axis=1)
    return own.reshape(*own.shape[:2], EXPRESSION_CHANNELS, -1).transpose(2, 3, 0, 1)


def exit_shapes(level: int) -> dict[str, tuple[int, ...]]:
    """Name and shape of the tensors that make an exit, its mesh excepted."""
    channels = trunk_layers(AvatarSpec(), level)[-1].out_channels
    shapes: dict[str, tuple[int, ...]] = {
        f"{PREFIX}{level}.expression.weight": (EXPRESSION_CHANNELS, channels, 3, 3),
        f"{PREFIX}{level}.expression.bias": (EXPRESSION_CHANNELS, level, level),
    }
    if level == EXIT_SIZES[0]:
        side = level // LOCAL_TEXELS
        shapes[local_name(level)] = (side, side, EXPRESSION_CHANNELS * channels)
    return shapes


def level_shapes(
    shapes: Mapping[str, tuple[int, ...]], max_faces: int
) -> dict[str, tuple[int, ...]]:
    """Shapes that the ``level.*`` tensors of a file with levels must have; ValueError if a number
    of triangles is out of its limits."""
    wanted: dict[str, tuple[int, ...]] = {STILL_NAME: LATENT_SHAPE}
    for level in EXIT_SIZES:
        faces = faces_name(level)
        count = (*shapes.get(faces, (1,)), 0)[0]
        if not 1 <= count <= max_faces:
            raise ValueError(f"tensor {faces} has {count} rows; allowed are 1 to {max_faces}")
        wanted |= exit_shapes(level) | {faces: (count, 3)}
    return wanted


STATIC_NAME = "static.parts"
MOVING, SEAM, STATIC = range(3)
_SHIFTS = np.array([0, 2, 4, 6], np.uint8)


def static_shape(num_vertices: int) -> tuple[int]:
    """Shape of the packed parts of so many vertices."""
    return (-(-num_vertices // 4),)


def pack_parts(parts: Array) -> ByteArray:
    """Parts of vertices ``[V]`` as the file holds them."""
    rows = np.zeros((static_shape(len(parts))[0], 4), np.uint8)
    rows.reshape(-1)[: len(parts)] = parts
    return np.bitwise_or.reduce(rows << _SHIFTS, axis=1)


def parts_of(tensors: Mapping[str, Array]) -> ByteArray | None:
    """The part that each vertex of an avatar belongs to, uint8 ``[V]``; None if all is decoded."""
    packed = tensors.get(STATIC_NAME)
    if packed is None:
        return None
    bits = ((packed[:, None] >> _SHIFTS) & 3).reshape(-1)
    return np.minimum(bits[: len(tensors["mesh.vertex_uv"])], STATIC).astype(np.uint8)


def decoded_faces(faces: IntArray, parts: ByteArray | None) -> IntArray:
    """The triangles ``[F, 3]`` that are to be decoded."""
    return faces if parts is None else faces[(parts[faces] != STATIC).any(axis=1)]


def textured_faces(faces: IntArray, parts: ByteArray | None) -> IntArray:
    """The triangles ``[F, 3]`` that have a texture; may be none."""
    return faces[:0] if parts is None else faces[(parts[faces] != MOVING).all(axis=1)]
