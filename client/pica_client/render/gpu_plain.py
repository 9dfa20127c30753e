"""Heads without a pixel decoder: the one that stands in for an avatar, and one with a texture, as
avatars were drawn before pixels were decoded, for comparison.
"""

import moderngl
import numpy as np

from pica_client.render.gpu_avatar import Body, Mesh, static_vertices
from pica_client.render.gpu_program import clamp
from pica_core.avatar.bust import WHOLE_M, box_corners, fade_heights_m, outline_of
from pica_core.files import packaged_json
from pica_core.reference import BaselineAvatar
from pica_core.sampling import order_faces
from pica_core.types import FloatArray

PLACEHOLDER_GRID = 64
"""Rows and columns of the placeholder's vertices."""
PLACEHOLDER_PROFILE_M = packaged_json("pica_client.render", "placeholder.json")
"""A faceless bust, from the crown down: height, half width, half depth, middle of the depth
(chosen: as large as a person, without a face)."""
LIGHT = np.array([0.30, 0.75, 0.60])
"""Where the light comes from, head frame."""
CLAY = (0.205, 0.225, 0.250), (0.520, 0.545, 0.570)
"""Its colours where it looks away from the light and towards it."""


def upload_placeholder(context: moderngl.Context, static: moderngl.Program) -> Body:
    """The head that stands in for an avatar that is not there or cannot be used: a plain bust in
    the room's light, matt as clay."""
    count, bust = PLACEHOLDER_GRID, placeholder_map()
    corner = np.arange(count * count, dtype=np.int32).reshape(count, count)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    faces = np.stack([a, c, b, b, c, d], axis=-1).reshape(-1, 3)
    texel = (np.arange(count, dtype=np.float32) + 0.5) / count
    u, v = np.meshgrid(texel, texel)
    corners = np.concatenate([bust, np.stack([u, v, np.ones_like(u)], axis=-1)], axis=-1)
    down, along = np.gradient(bust, axis=(0, 1))
    normals = np.cross(down, along) + np.array([0.0, 1e-12, 0.0])  # the crown looks up
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    light = 0.5 + 0.5 * (normals @ (LIGHT / np.linalg.norm(LIGHT)))[..., None]
    dark, bright = np.array(CLAY)
    rgba = np.full((count, count, 4), 255, np.uint8)
    rgba[..., :3] = 255 * (dark + light**2 * (bright - dark)) + 0.5
    low_m, high_m = bust.min(axis=(0, 1)), bust.max(axis=(0, 1))
    vertices = static_vertices(context, static, faces, corners.reshape(-1, 6), "3f 2f 1f")
    return Body(
        meshes={0: Mesh(None, vertices, len(faces))},
        low_m=tuple(low_m.tolist()),
        high_m=tuple(high_m.tolist()),
        outline_m=outline_of(bust.reshape(-1, 3)),
        fade_m=fade_heights_m(float(low_m[1])),
        skin=clamp(context.texture((count, count), 4, rgba.tobytes())),
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

    Attributes:
        body: What is drawn once it has been updated.
    """

    def __init__(
        self,
        context: moderngl.Context,
        static: moderngl.Program,
        avatar: BaselineAvatar,
        *,
        fades: bool = False,
    ) -> None:
        count, side = len(avatar.vertex_uv), avatar.spec.texture_size
        self._positions = context.buffer(reserve=12 * count, dynamic=True)
        corners = np.concatenate([avatar.vertex_uv, np.ones((count, 1))], axis=1)
        uv = context.buffer(np.ascontiguousarray(corners, np.float32).tobytes())
        faces = order_faces(avatar.faces, avatar.vertex_uv)
        vertices = context.vertex_array(
            static,
            [
                (self._positions, "3f", "vertex_xyz_m"),
                (uv, "2f 1f", "vertex_uv", "vertex_opacity"),
            ],
            index_buffer=context.buffer(np.ascontiguousarray(faces, np.int32).tobytes()),
        )
        self._texture = clamp(context.texture((side, side), 4))
        self._rgba = np.full((side, side, 4), 255, np.uint8)
        low_m, high_m = avatar.bounds_min_m, avatar.bounds_max_m
        self.body = Body(
            meshes={0: Mesh(None, vertices, len(faces))},
            low_m=low_m,
            high_m=high_m,
            outline_m=outline_of(box_corners(low_m, high_m)),
            fade_m=fade_heights_m(low_m[1]) if fades else WHOLE_M,
            skin=self._texture,
        )

    def update(self, vertices_m: FloatArray, texture: FloatArray) -> None:
        """Upload what a decoder made.

        Args:
            vertices_m: Head frame, metres. float32 ``[V, 3]``.
            texture: RGB, 0..1. float32 ``[T, T, 3]``; stored with 8 bits, which draw fastest.
        """
        self._positions.write(np.ascontiguousarray(vertices_m))
        steps = np.nan_to_num(texture, nan=0.0, posinf=1.0, neginf=0.0)
        self._rgba[..., :3] = np.clip(steps, 0.0, 1.0) * 255.0 + 0.5
        self._texture.write(self._rgba)
