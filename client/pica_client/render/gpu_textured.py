"""A head with a texture: how avatars were drawn before pixels were decoded, for comparison.

Its decoder makes vertices and a whole texture for each frame; both are uploaded, and the mesh is
drawn in one pass.
"""

import moderngl
import numpy as np

from pica_client.render.gpu_program import clamp
from pica_core.avatar.bust import WHOLE_M, box_corners, fade_heights_m, outline_of
from pica_core.errors import ShapeError
from pica_core.reference.baseline import BaselineAvatar
from pica_core.sampling import order_faces
from pica_core.types import FloatArray


class TexturedHead:
    """A textured head on the GPU; one that `fades` does so above the lower end of its box."""

    def __init__(
        self,
        context: moderngl.Context,
        program: moderngl.Program,
        avatar: BaselineAvatar,
        *,
        fades: bool = False,
    ) -> None:
        self.low_m, self.high_m = avatar.bounds_min_m, avatar.bounds_max_m
        self.outline_m = outline_of(box_corners(self.low_m, self.high_m))
        self.fade_m = fade_heights_m(self.low_m[1]) if fades else WHOLE_M
        self.level, self.num_triangles = 0, len(avatar.faces)
        self._num_vertices = len(avatar.vertex_uv)
        self._positions = context.buffer(reserve=12 * self._num_vertices, dynamic=True)
        corners = context.buffer(np.ascontiguousarray(avatar.vertex_uv, np.float32).tobytes())
        faces = order_faces(avatar.faces, avatar.vertex_uv)
        self.vertices = context.vertex_array(
            program,
            [(self._positions, "3f", "vertex_xyz_m"), (corners, "2f", "vertex_uv")],
            index_buffer=context.buffer(np.ascontiguousarray(faces, np.int32).tobytes()),
        )
        side = avatar.spec.texture_size
        self.texture = clamp(context.texture((side, side), 4))
        self._rgba = np.full((side, side, 4), 255, np.uint8)
        self.has_maps = False

    def update(self, vertices_m: FloatArray, texture: FloatArray) -> None:
        """Upload what a decoder made.

        Args:
            vertices_m: Head frame, metres. float32 ``[V, 3]``.
            texture: RGB, 0..1. float32 ``[T, T, 3]``; stored with 8 bits, which draw fastest.

        Raises:
            ShapeError: Other shapes or types.
        """
        for name, array, wanted in (
            ("vertices_m", vertices_m, (self._num_vertices, 3)),
            ("texture", texture, (*self._rgba.shape[:2], 3)),
        ):
            if array.shape != wanted or array.dtype != np.float32:
                raise ShapeError(
                    f"{name} is {array.dtype} {array.shape}; float32 {wanted} is needed"
                )
        self._positions.write(np.ascontiguousarray(vertices_m))
        steps = np.nan_to_num(texture, nan=0.0, posinf=1.0, neginf=0.0)
        self._rgba[..., :3] = np.clip(steps, 0.0, 1.0) * 255.0 + 0.5
        self.texture.write(self._rgba)
        self.has_maps = True
