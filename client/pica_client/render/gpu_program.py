"""Shader programs: text from package files, compiled; and the texture units that all agree on.

Composing is text work; no GPU is needed to test it. The same files come out as desktop GLSL 3.30
and as GLSL ES 3.00, the dialect of a browser.

    fragment = compose("pixel_decoder.frag", spec, generated={"siren.glsl": siren_source(spec)})
    program = build_program(context, compose("rect.vert"), fragment)
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any, Literal

import moderngl

from pica_client.errors import ShaderError
from pica_core.avatar.spec import NUM_FREQUENCIES, AvatarSpec
from pica_core.gl import link_program

Dialect = Literal["330 core", "300 es"]

LINES_PER_FILE = 10_000
MAX_ERRORS = 4
"""How many of a driver's complaints are told; the first is the cause, the others follow from it."""
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
_INCLUDE = re.compile(r'#include "([^"]*)"')
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


@dataclass(frozen=True, slots=True)
class ShaderSource:
    """Composed text, and the files it came from.

    Line n of file i is numbered ``i * LINES_PER_FILE + n``: drivers keep line numbers but not all
    keep source numbers.
    """

    text: str
    files: tuple[str, ...]

    def explain(self, log: str) -> str:
        """The errors of a driver's message, with our file names and lines.

        Mesa writes ``0:20017(5): error: …``, Nvidia ``0(20017) : error …``, Apple ``ERROR: 0:20017:
        …``; all become ``siren.glsl:17: …``.
        """

        def name(match: re.Match[str]) -> str:
            number, line = divmod(int(match["line"]), LINES_PER_FILE)
            return f"{self.files[number]}:{line}:" if number < len(self.files) else match[0]

        pattern = r"^(?:ERROR: )?0[:(](?P<line>\d+)\)?(?:\(\d+\))?\s*:"
        lines = [line for line in log.splitlines() if "error" in line.lower()]
        told = [re.sub(pattern, name, line) for line in lines]
        return "; ".join(told[:MAX_ERRORS]) or log.strip()


def compose(
    name: str,
    spec: AvatarSpec | None = None,
    *,
    dialect: Dialect = "330 core",
    generated: Mapping[str, str] = _NOTHING,
    defines: Mapping[str, object] = _NOTHING,
) -> ShaderSource:
    """Compose one shader.

    Args:
        name: File in ``pica_client/render/shaders``.
        spec: Sizes for the generated header; None for shaders that know no avatar.
        dialect: Desktop GL or GL ES.
        generated: Texts to include that are in no file, by name.
    """
    lines, names = [f"#version {dialect}"], ["generated header"]
    if dialect == "300 es":
        lines += _PRECISION
    defines = {**defines, **({} if spec is None else _sizes(spec))}
    lines += [f"#define {key} {value}".rstrip() for key, value in defines.items()]

    def include(name: str) -> None:
        number = LINES_PER_FILE * len(names)
        names.append(name)
        lines.append(f"#line {number + 1}")
        text = generated[name] if name in generated else _read(name)
        for line in text.splitlines():
            number += 1
            if match := _INCLUDE.match(line):
                include(match[1])
                lines.append(f"#line {number + 1}")
            else:
                lines.append(line)

    include(name)
    return ShaderSource("\n".join(lines) + "\n", tuple(names))


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
    if "rect" in program:
        set_values(program, rect=(-1.0, -1.0, 1.0, 1.0))
    return program


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
