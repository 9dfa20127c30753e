"""What the GPU holds of an avatar: its mesh, encodings and program; and of the head that stands in
for one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import moderngl
import numpy as np
import numpy.typing as npt

from pica_client.errors import ShaderError
from pica_client.shader_source import AXIS_ROW, ShaderSource, compose
from pica_client.shader_weights import pack_weights, siren_source
from pica_core.avatar_file import Avatar
from pica_core.gl import link_program
from pica_core.mesh import order_faces
from pica_core.spec import AvatarSpec

FloatArray = npt.NDArray[np.float32]
WeightsPlace = Literal["block", "constants"]

ENCODING_OF_VARIANT = {"full": "encoding_full.glsl"}
"""The shader file with a variant's surface encoding."""

UNIT_VISIBLE_XYZ, UNIT_VISIBLE_UV, UNIT_POSITION, UNIT_EXPRESSION = 0, 1, 2, 3
UNIT_UV_ENCODING, UNIT_U_ENCODING, UNIT_V_ENCODING = 4, 5, 6
_UNITS = {
    "visible_xyz": UNIT_VISIBLE_XYZ,
    "visible_uv": UNIT_VISIBLE_UV,
    "position_map": UNIT_POSITION,
    "expression_map": UNIT_EXPRESSION,
    "uv_encoding": UNIT_UV_ENCODING,
    "u_encoding": UNIT_U_ENCODING,
    "v_encoding": UNIT_V_ENCODING,
}

PLACEHOLDER_RADII_M = (0.078, 0.115, 0.095)
_PLACEHOLDER_GRID = 33


def build_program(
    context: moderngl.Context, vertex: ShaderSource, fragment: ShaderSource
) -> moderngl.Program:
    """Compile and link; sampler units of known names are set.

    Raises:
        ShaderError: The driver refuses; its message names our files and lines.
    """
    try:
        program = link_program(context, vertex=vertex.text, fragment=fragment.text)
    except moderngl.Error as error:
        at_fault = vertex if "vertex_shader" in str(error) else fragment
        raise ShaderError(f"the driver refuses a shader: {at_fault.explain(str(error))}") from error
    for name, unit in _UNITS.items():
        if name in program:
            program[name] = unit
    return program


def set_matrix(program: moderngl.Program, name: str, matrix: FloatArray) -> None:
    """Set a mat4 uniform from a matrix for column vectors."""
    member: Any = program[name]
    member.write(np.ascontiguousarray(matrix.T, np.float32).tobytes())


@dataclass(slots=True, eq=False)
class Shared:
    """What all seats with the same avatar share. Created by `upload_avatar` and
    `upload_placeholder`."""

    mesh: moderngl.VertexArray
    num_triangles: int
    shade: moderngl.Program
    shade_rect: moderngl.VertexArray
    textures: dict[int, moderngl.Texture]
    """By texture unit."""
    weights: moderngl.Buffer | None
    """Bound to uniform block 0; None if the program holds them as constants."""
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]

    def bind(self) -> None:
        """Make its textures and weights current."""
        for unit, texture in self.textures.items():
            texture.use(unit)
        if self.weights is not None:
            self.weights.bind_to_uniform_block(0)


def upload_avatar(
    context: moderngl.Context,
    mesh_program: moderngl.Program,
    avatar: Avatar,
    weights_place: WeightsPlace,
) -> Shared:
    """Put everything of an avatar but its two decoded maps on the GPU.

    Raises:
        ShaderError: Sizes that the shader does not hold, or a driver that refuses it.
    """
    tensors, manifest = avatar.tensors, avatar.manifest
    program = decoder_program(context, avatar, weights_place)
    encoding = np.ascontiguousarray(tensors["uv_encoding"], np.float16)
    uv_encoding = context.texture(
        encoding.shape[1::-1], encoding.shape[2], encoding.tobytes(), dtype="f2", alignment=1
    )
    _clamp(uv_encoding, moderngl.LINEAR)
    textures = {UNIT_UV_ENCODING: uv_encoding}
    for unit, name in ((UNIT_U_ENCODING, "u_encoding"), (UNIT_V_ENCODING, "v_encoding")):
        textures[unit] = _axis_texture(context, tensors[name])
    weights = None
    if weights_place == "block":
        weights = context.buffer(pack_weights(avatar.spec, tensors))
    # Neighbours together: in the order of a shuffled file five heads take half as long again to
    # draw.
    faces = order_faces(tensors["mesh.faces"], tensors["mesh.vertex_uv"])
    return Shared(
        mesh=_mesh(context, mesh_program, tensors["mesh.vertex_uv"], faces),
        num_triangles=len(tensors["mesh.faces"]),
        shade=program,
        shade_rect=context.vertex_array(program, []),
        textures=textures,
        weights=weights,
        low_m=manifest.bounds_min_m,
        high_m=manifest.bounds_max_m,
    )


def decoder_program(
    context: moderngl.Context, avatar: Avatar, weights_place: WeightsPlace
) -> moderngl.Program:
    """The program of the second pass for an avatar."""
    baked = avatar.tensors if weights_place == "constants" else None
    fragment = compose(
        "pixel_decoder.frag",
        avatar.spec,
        choices={"ENCODING": ENCODING_OF_VARIANT[avatar.manifest.variant]},
        generated={"SIREN": siren_source(avatar.spec, baked)},
    )
    return build_program(context, compose("rect.vert"), fragment)


def upload_placeholder(context: moderngl.Context, mesh_program: moderngl.Program) -> Shared:
    """The head that stands in for an avatar that is not there or cannot be used."""
    program = build_program(context, compose("rect.vert"), compose("placeholder.frag"))
    radii: Any = program["radii_m"]
    radii.value = PLACEHOLDER_RADII_M
    count = _PLACEHOLDER_GRID
    corner = np.arange(count * count, dtype=np.int32).reshape(count, count)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    faces = np.stack([a, c, b, b, c, d], axis=-1).reshape(-1, 3)
    # Texel centres, so that the mesh closes exactly on the map's border texels.
    texel = (np.arange(count, dtype=np.float32) + 0.5) / count
    vertex_uv = np.stack(np.meshgrid(texel, texel), axis=-1).reshape(-1, 2)
    low_x, low_y, low_z = (-radius for radius in PLACEHOLDER_RADII_M)
    return Shared(
        mesh=_mesh(context, mesh_program, vertex_uv, faces),
        num_triangles=len(faces),
        shade=program,
        shade_rect=context.vertex_array(program, []),
        textures={UNIT_POSITION: position_texture(context, _ellipsoid(count))},
        weights=None,
        low_m=(low_x, low_y, low_z),
        high_m=PLACEHOLDER_RADII_M,
    )


def position_texture(context: moderngl.Context, position_map: FloatArray) -> moderngl.Texture:
    """A texture for a position map ``[S, S, 3]``; 32-bit floats, looked up by texelFetch."""
    size = position_map.shape[1::-1]
    texture = context.texture(size, 3, position_map.tobytes(), dtype="f4")
    _clamp(texture, moderngl.NEAREST)
    return texture


def expression_texture(context: moderngl.Context, spec: AvatarSpec) -> moderngl.Texture:
    """An empty texture for expression maps of a spec.

    32-bit floats: converting a map to 16 bits on the CPU takes 0.4 ms, uploading it as it is 0.02
    ms (llvmpipe).
    """
    size = (spec.map_size, spec.map_size)
    texture = context.texture(size, spec.expression_channels, dtype="f4")
    _clamp(texture, moderngl.LINEAR)
    return texture


def _ellipsoid(count: int) -> FloatArray:
    """A closed ellipsoid as a position map, columns around +y and rows from the crown down."""
    turn = np.linspace(-np.pi, np.pi, count, dtype=np.float32)
    tilt = np.linspace(0, np.pi, count, dtype=np.float32)[:, None]
    unit = np.stack(
        [np.sin(tilt) * np.sin(turn), np.cos(tilt) + 0 * turn, np.sin(tilt) * np.cos(turn)], axis=-1
    )
    ellipsoid: FloatArray = np.ascontiguousarray(unit * PLACEHOLDER_RADII_M, np.float32)
    return ellipsoid


def _mesh(
    context: moderngl.Context,
    program: moderngl.Program,
    vertex_uv: npt.NDArray[Any],
    faces: npt.NDArray[Any],
) -> moderngl.VertexArray:
    return context.vertex_array(
        program,
        [
            (
                context.buffer(np.ascontiguousarray(vertex_uv, np.float32).tobytes()),
                "2f",
                "vertex_uv",
            )
        ],
        index_buffer=context.buffer(np.ascontiguousarray(faces, np.int32).tobytes()),
    )


def _axis_texture(context: moderngl.Context, table: npt.NDArray[Any]) -> moderngl.Texture:
    """Fold a table ``[L, C]`` into rows of `AXIS_ROW` texels, 32-bit floats."""
    count, channels = table.shape
    rows = -(-count // AXIS_ROW)
    folded = np.zeros((rows * AXIS_ROW, channels), np.float32)
    folded[:count] = table
    texture = context.texture((AXIS_ROW, rows), channels, folded.tobytes(), dtype="f4")
    _clamp(texture, moderngl.NEAREST)
    return texture


def _clamp(texture: moderngl.Texture, filtering: int) -> None:
    texture.filter = (filtering, filtering)
    texture.repeat_x = texture.repeat_y = False
