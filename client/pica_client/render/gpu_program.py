"""Compiled shaders, and the texture units that all of them agree on."""

from typing import Any

import moderngl
import numpy as np

from pica_client.errors import ShaderError
from pica_client.render.shader_source import ShaderSource
from pica_core.gl import link_program
from pica_core.types import FloatArray

UNIT_VISIBLE_XYZ, UNIT_VISIBLE_UV, UNIT_POSITION, UNIT_EXPRESSION = 0, 1, 2, 3
UNIT_UV_ENCODING, UNIT_U_ENCODING, UNIT_V_ENCODING = 4, 5, 6
UNIT_SKIN, UNIT_STILL = 7, 8
UNIT_ROOM, UNIT_LAYER = 0, 1
_SAMPLERS = {
    "visible_xyz": UNIT_VISIBLE_XYZ,
    "visible_uv": UNIT_VISIBLE_UV,
    "position_map": UNIT_POSITION,
    "expression_map": UNIT_EXPRESSION,
    "uv_encoding": UNIT_UV_ENCODING,
    "u_encoding": UNIT_U_ENCODING,
    "v_encoding": UNIT_V_ENCODING,
    "skin": UNIT_SKIN,
    "still_map": UNIT_STILL,
    "room": UNIT_ROOM,
    "layer": UNIT_LAYER,
}
"""What shaders call these units."""


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
    for name, unit in _SAMPLERS.items():
        if name in program:
            program[name] = unit
    return program


def clamp(texture: moderngl.Texture, filtering: int = moderngl.LINEAR) -> moderngl.Texture:
    """Have a texture end at its borders, and looked up by `filtering`; gives it back."""
    texture.filter = (filtering, filtering)
    texture.repeat_x = texture.repeat_y = False
    return texture


def set_matrix(program: moderngl.Program, name: str, matrix: FloatArray) -> None:
    """Set a mat4 uniform from a matrix for column vectors."""
    member: Any = program[name]
    member.write(np.ascontiguousarray(matrix.T, np.float32).tobytes())


def set_values(program: moderngl.Program, **values: float | tuple[float, ...]) -> None:
    """Set uniforms by name."""
    for name, value in values.items():
        member: Any = program[name]
        member.value = value
