"""Shader programs: text from package files, compiled; and the texture units that all agree on.

Composing is text work; no GPU is needed to test it. The same files come out as desktop GLSL 3.30
and as GLSL ES 3.00, the dialect of a browser.

    fragment = compose("pixel_decoder.frag", spec, generated={"siren.glsl": siren_source(spec)})
    program = build_program(context, compose("rect.vert"), fragment)
"""

import math
import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any, Literal

import moderngl

from pica_client.errors import ShaderError
from pica_core.avatar.spec import NUM_FREQUENCIES, AvatarSpec
from pica_core.gl import link_program

Dialect = Literal["330 core", "300 es"]

AXIS_ROW = 1024
"""Entries per texture row of the per-axis encodings: the narrowest largest texture of GL 3.3. A
power of two: the shader takes remainders by its bits."""
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
_PRECISION = [
    f"precision highp {kind};"
    for kind in ("float", "int", "sampler2D", "sampler2DArray", "usampler2DArray")
]
_INCLUDE = re.compile(r'^#include "([^"]*)".*$', re.MULTILINE)
_NOTHING: Mapping[str, str] = MappingProxyType({})
_CODES: Mapping[str, str] = MappingProxyType(
    {
        "joint": "joint_code(uv, reach)",
        "axes": "axis_codes(uv, reach)",
        "uv": "vec4(2.0 * uv - 1.0, 0.0, 0.0)",
        "sinusoids": ", ".join(f"octave_code(uv, reach, {k}.0)" for k in range(NUM_FREQUENCIES)),
    }
)
"""What the pixel decoder gets of each part of a surface encoding (`ENCODINGS`)."""


def compose(
    name: str,
    spec: AvatarSpec | None = None,
    *,
    dialect: Dialect = "330 core",
    generated: Mapping[str, str] = _NOTHING,
    defines: Mapping[str, object] = _NOTHING,
) -> str:
    """Compose the text of one shader.

    Args:
        name: File in ``pica_client/render/shaders``.
        spec: Sizes for the generated header; None for shaders that know no avatar.
        dialect: Desktop GL or GL ES.
        generated: Texts to include that are in no file, by name.
    """
    lines = [f"#version {dialect}", *(_PRECISION if dialect == "300 es" else ())]
    defines = {**defines, **({} if spec is None else _sizes(spec))}
    lines += [f"#define {key} {value}".rstrip() for key, value in defines.items()]

    def included(name: str) -> str:
        text = generated[name] if name in generated else _read(name)
        return _INCLUDE.sub(lambda match: included(match[1]), text)

    return "\n".join([*lines, included(name)])


def _sizes(spec: AvatarSpec) -> dict[str, object]:
    """What the pixel decoder's text depends on."""
    levels = axis_levels(spec.axis_encoding_size)
    return {
        "AXIS_SIZE": spec.axis_encoding_size,
        "AXIS_ROW": AXIS_ROW,
        "AXIS_LEVELS": levels,
        "AXIS_STRIDE": 1 << (levels - 1),
        "LOG2_AXIS_SIZE": f"{math.log2(spec.axis_encoding_size):.6f}",
        "LOG2_UV_SIZE": f"{math.log2(spec.uv_encoding_size):.6f}",
        "SURFACE_CODES": "".join(f", {_CODES[part]}" for part in spec.encoding_channels),
    }


def axis_levels(count: int) -> int:
    """Levels of a table of `count` entries: each has half the entries of the one before, the last
    one has one."""
    return (count - 1).bit_length() + 1


@cache
def _read(name: str) -> str:
    return (files("pica_client.render") / "shaders" / name).read_text(encoding="utf-8")


def build_program(context: moderngl.Context, vertex: str, fragment: str) -> moderngl.Program:
    """Compile and link; sampler units of known names are set.

    Raises:
        ShaderError: The driver refuses; the message has the line that it complains of.
    """
    try:
        program = link_program(context, vertex=vertex, fragment=fragment)
    except moderngl.Error as error:
        at_fault = vertex if "vertex_shader" in str(error) else fragment
        raise ShaderError(
            f"the driver refuses a shader: {complaint(str(error), at_fault)}"
        ) from error
    for name, unit in _SAMPLERS.items():
        if name in program:
            program[name] = unit
    if "rect" in program:
        set_values(program, rect=(-1.0, -1.0, 1.0, 1.0))
    return program


def complaint(log: str, text: str) -> str:
    """The first error of a driver's message, which the others follow from, and the line of the text
    that it complains of.

    Mesa writes ``0:17(5): error: …``, Nvidia ``0(17) : error …``, Apple ``ERROR: 0:17: …``.
    """
    first = next((line for line in log.splitlines() if "error" in line.lower()), log.strip())
    number, lines = re.search(r"\b0[:(](\d+)", first), text.splitlines()
    if number is None or not 1 <= int(number[1]) <= len(lines):
        return first
    return f"{first} in {lines[int(number[1]) - 1].strip()!r}"


def clamp(texture: moderngl.Texture, filtering: int = moderngl.LINEAR) -> moderngl.Texture:
    """Have a texture end at its borders, and looked up by `filtering`; gives it back."""
    texture.filter = (filtering, filtering)
    texture.repeat_x = texture.repeat_y = False
    return texture


def set_values(program: moderngl.Program, **values: float | tuple[Any, ...]) -> None:
    """Set uniforms by name."""
    for name, value in values.items():
        member: Any = program[name]
        member.value = value
