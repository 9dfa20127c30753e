"""Static surfaces: what of a head looks the same whatever the face does, such as a pullover.

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

from pica_core.types import Array, ByteArray, IntArray

NAME = "static.parts"
MOVING, SEAM, STATIC = range(3)
_SHIFTS = np.array([0, 2, 4, 6], np.uint8)


def static_shape(num_vertices: int) -> tuple[int]:
    """Shape of the packed parts of so many vertices."""
    return (-(-num_vertices // 4),)


def pack_parts(parts: Array) -> ByteArray:
    """Parts of vertices ``[V]`` as the file holds them."""
    rows = np.zeros((static_shape(len(parts))[0], 4), np.uint8)
    rows.reshape(-1)[: len(parts)] = parts
    packed: ByteArray = np.bitwise_or.reduce(rows << _SHIFTS, axis=1)
    return packed


def parts_of(tensors: Mapping[str, Array]) -> ByteArray | None:
    """The part that each vertex of an avatar belongs to, uint8 ``[V]``; None if all is decoded."""
    packed = tensors.get(NAME)
    if packed is None:
        return None
    bits = ((packed[:, None] >> _SHIFTS) & 3).reshape(-1)
    parts: ByteArray = np.minimum(bits[: len(tensors["mesh.vertex_uv"])], STATIC).astype(np.uint8)
    return parts


def decoded_faces(faces: IntArray, parts: ByteArray | None) -> IntArray:
    """The triangles ``[F, 3]`` that are to be decoded."""
    return faces if parts is None else faces[(parts[faces] != STATIC).any(axis=1)]


def textured_faces(faces: IntArray, parts: ByteArray | None) -> IntArray:
    """The triangles ``[F, 3]`` that have a texture; may be none."""
    return faces[:0] if parts is None else faces[(parts[faces] != MOVING).all(axis=1)]
