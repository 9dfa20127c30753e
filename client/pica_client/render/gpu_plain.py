"""Heads without a pixel decoder: the one that stands in for an avatar, and one with a texture, as
avatars were drawn before pixels were decoded, for comparison.
"""

import moderngl
import numpy as np

from pica_client.render.gpu_avatar import Body, MeshPrograms, upload_mesh
from pica_client.render.gpu_program import UNIT_POSITION, build_program, clamp, compose
from pica_core.avatar.bust import WHOLE_M, box_corners, fade_heights_m, outline_of
from pica_core.errors import ShapeError
from pica_core.reference import BaselineAvatar
from pica_core.sampling import order_faces
from pica_core.types import FloatArray

PLACEHOLDER_GRID = 64
"""Rows and columns of the placeholder's position map."""
PLACEHOLDER_PROFILE_M = (
    # height, half width, half depth, middle of the depth
    (0.138, 0.000, 0.000, 0.000),
    (0.132, 0.031, 0.038, 0.000),
    (0.112, 0.057, 0.070, 0.000),
    (0.075, 0.075, 0.092, 0.000),
    (0.030, 0.080, 0.098, 0.002),
    (-0.020, 0.075, 0.092, 0.006),
    (-0.060, 0.066, 0.080, 0.012),
    (-0.090, 0.053, 0.064, 0.012),
    (-0.104, 0.047, 0.054, 0.002),
    (-0.124, 0.047, 0.050, -0.012),
    (-0.138, 0.062, 0.058, -0.018),
    (-0.150, 0.108, 0.074, -0.022),
    (-0.166, 0.146, 0.086, -0.026),
    (-0.192, 0.167, 0.094, -0.028),
    (-0.230, 0.174, 0.098, -0.028),
    (-0.290, 0.174, 0.098, -0.028),
)
"""A faceless bust, from the crown down (chosen: as large as a person, without a face)."""


def upload_placeholder(context: moderngl.Context, mesh_programs: MeshPrograms) -> Body:
    """The head that stands in for an avatar that is not there or cannot be used."""
    program = build_program(context, compose("rect.vert"), compose("placeholder.frag"))
    count, bust = PLACEHOLDER_GRID, placeholder_map()
    corner = np.arange(count * count, dtype=np.int32).reshape(count, count)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    faces = np.stack([a, c, b, b, c, d], axis=-1).reshape(-1, 3)
    # Texel centres, so that the mesh closes exactly on the map's border texels.
    texel = (np.arange(count, dtype=np.float32) + 0.5) / count
    vertex_uv = np.stack(np.meshgrid(texel, texel), axis=-1).reshape(-1, 2)
    texture = context.texture((count, count), 3, bust.tobytes(), dtype="f4")
    low_m, high_m = bust.min(axis=(0, 1)), bust.max(axis=(0, 1))
    return Body(
        meshes={(0, 0): upload_mesh(context, mesh_programs, 0, faces, vertex_uv, vertex_uv)},
        shade=context.vertex_array(program, []),
        textures={UNIT_POSITION: clamp(texture)},
        weights=None,
        skin=None,
        low_m=tuple(low_m.tolist()),
        high_m=tuple(high_m.tolist()),
        outline_m=outline_of(bust.reshape(-1, 3)),
        fade_m=fade_heights_m(float(low_m[1])),
    )


def placeholder_map() -> FloatArray:
    """The faceless bust as a position map, columns around +y and rows from the crown down: the
    profile at even steps along itself, its corners rounded. float32 ``[S, S, 3]``."""
    profile = np.array(PLACEHOLDER_PROFILE_M)
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(profile[:, :3], axis=0), axis=1))])
    steps = np.linspace(0, way[-1], PLACEHOLDER_GRID)
    rows = np.stack([np.interp(steps, way, column) for column in profile.T], axis=1)
    for _ in range(3):
        rows[1:-1] = 0.25 * rows[:-2] + 0.5 * rows[1:-1] + 0.25 * rows[2:]
    height, wide, deep, middle = (column[:, None] for column in rows.T)
    turn = np.linspace(-np.pi, np.pi, PLACEHOLDER_GRID)
    around = [wide * np.sin(turn), height + 0 * turn, middle + deep * np.cos(turn)]
    bust: FloatArray = np.ascontiguousarray(np.stack(around, axis=-1), np.float32)
    return bust


class TexturedHead:
    """A textured head on the GPU; one that `fades` does so above the lower end of its box.

    Its decoder makes vertices and a whole texture for each frame; both are uploaded, and the mesh
    is drawn in one pass.
    """

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
