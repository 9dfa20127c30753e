"""The texture of what does not change with the face, made when an avatar comes.

The avatar's own pixel decoder makes it: the mesh at rest is laid out flat by its UVs, and each
texel is coloured as a pixel of the still face. So nothing of it stands in the file, and none can
disagree with what is decoded beside it.
"""

from collections.abc import Callable

import moderngl
import numpy as np

from pica_client.render.gpu_program import (
    UNIT_VISIBLE_UV,
    UNIT_VISIBLE_XYZ,
    clamp,
    set_values,
)
from pica_core.avatar.bust import WHOLE_M
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import MAP_SIZE
from pica_core.types import Array

TEXTURE_PX = 1024
"""Side of the texture (measured on heads at 18 to 200 cm: MSE 0.3 to 0.6 against decoded pixels; at
512 it is 0.4 to 0.8, for 22 of 169 ms less when an avatar comes). It is looked up bilinearly: three
mip levels cost 1 ms of an image of 2.4, and leave more error, in stills and in what changes as a
head moves."""
MARGIN_PX = 8
"""So far beside its charts a texture has their colours."""
_WHOLE_SCREEN = (-1.0, -1.0, 1.0, 1.0)


def bake_texture(
    context: moderngl.Context,
    unwrap: moderngl.Program,
    shade: moderngl.VertexArray,
    avatar: Avatar,
    bind_still: Callable[[], None],
) -> moderngl.Texture:
    """Colour the still face wherever it has a texture.

    Args:
        unwrap: Lays a mesh out flat.
        shade: The avatar's pixel decoder.
        bind_still: Makes what it reads current, its still map as the expression map.
    """
    size = (TEXTURE_PX, TEXTURE_PX)
    xyz, uv = context.texture(size, 4, dtype="f4"), context.texture(size, 2, dtype="nu2")
    depth = context.depth_renderbuffer(size)
    texture = clamp(context.texture(size, 4))
    surface = context.framebuffer([xyz, uv], depth)
    coloured = context.framebuffer([texture], depth)
    rest_m, vertex_uv = avatar.mean_vertices_m, avatar.tensors["mesh.vertex_uv"]
    corners = np.concatenate([rest_m, vertex_uv], axis=1)
    faces = avatar.textured_faces(avatar.levels[-1])
    flat = static_vertices(context, unwrap, faces, corners, "3f 2f")

    context.enable_only(moderngl.DEPTH_TEST)
    context.depth_func = "<"
    coloured.clear()
    surface.use()
    surface.clear(depth=1.0)
    set_values(unwrap, slot=1.0, margin=MARGIN_PX / TEXTURE_PX)
    flat.render(instances=9)

    bind_still()
    xyz.use(UNIT_VISIBLE_XYZ)
    uv.use(UNIT_VISIBLE_UV)
    coloured.use()
    coloured.depth_mask = False
    context.depth_func = ">"
    set_values(shade.program, expression_rows=(0, MAP_SIZE, MAP_SIZE, False))
    set_values(shade.program, slot=1.0, shown=WHOLE_M, rect=_WHOLE_SCREEN)
    shade.render(moderngl.TRIANGLE_STRIP, vertices=4)
    context.depth_func = "<"
    context.detect_framebuffer(0).use()  # those of here are freed
    return texture


def static_vertices(
    context: moderngl.Context, program: moderngl.Program, faces: Array, corners: Array, layout: str
) -> moderngl.VertexArray:
    """Triangles ``[F, 3]`` over those of the corners ``[V, C]`` that they use: places, UVs and,
    where the layout has it, opacities."""
    used, numbers = np.unique(faces, return_inverse=True)
    content = np.ascontiguousarray(corners[used], np.float32).tobytes()
    names = ("vertex_xyz_m", "vertex_uv", "vertex_opacity")[: len(layout.split())]
    return context.vertex_array(
        program,
        [(context.buffer(content), layout, *names)],
        index_buffer=context.buffer(np.ascontiguousarray(numbers, np.int32).tobytes()),
    )
