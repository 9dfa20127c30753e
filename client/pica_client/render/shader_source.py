"""Shader text from package files: includes, a generated header of sizes, and line numbers that
point at our files.

Pure text work; no GPU is needed to test it. The same files come out as desktop GLSL 3.30 and as
GLSL ES 3.00, the dialect of a browser.

    source = compose("pixel_decoder.frag", spec, generated={"SIREN": siren_source(spec)})
    link_program(context, vertex=..., fragment=source.text)

``#include "file"`` takes a file, ``#include NAME`` the text generated for that name. A file is
included once; naming one that does not exist is an error, as is a chain deeper than `MAX_DEPTH`.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Literal

from pica_client.errors import ShaderError
from pica_core.avatar.spec import NUM_FREQUENCIES, AvatarSpec

Dialect = Literal["330 core", "300 es"]

MAX_DEPTH = 8
LINES_PER_FILE = 10_000
MAX_ERRORS = 4
"""How many of a driver's complaints are told; the first is the cause, the others follow from it."""
AXIS_ROW = 1024
"""Entries per texture row of the per-axis encodings: the narrowest largest texture of GL 3.3. A
power of two: the shader takes remainders by its bits."""

_INCLUDE = re.compile(r'\s*#include\s+(?:"(?P<file>[^"]*)"|(?P<name>\w+))\s*(?://.*)?$')
_PRECISION = "".join(
    f"precision highp {kind};\n"
    for kind in ("float", "int", "sampler2D", "sampler2DArray", "usampler2DArray")
)
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
    defines: Mapping[str, str] = _NOTHING,
) -> ShaderSource:
    """Compose one shader.

    Args:
        name: File in ``pica_client/shaders``.
        spec: Sizes for the generated header; None for shaders that know no avatar.
        dialect: Desktop GL or GL ES.
        generated: Text for an ``#include NAME``.

    Raises:
        ShaderError: A file or a name is unknown, or includes nest too deeply.
    """
    lines = [f"#version {dialect}"]
    if dialect == "300 es":
        lines.append(_PRECISION.rstrip())
    lines += [f"#define {key} {value}".rstrip() for key, value in defines.items()]
    if spec is not None:
        levels = axis_levels(spec.axis_encoding_size)
        lines += [
            f"#define AXIS_SIZE {spec.axis_encoding_size}",
            f"#define AXIS_ROW {AXIS_ROW}",
            f"#define AXIS_LEVELS {levels}",
            f"#define AXIS_STRIDE {1 << (levels - 1)}",
            f"#define LOG2_AXIS_SIZE {math.log2(spec.axis_encoding_size):.6f}",
            f"#define LOG2_UV_SIZE {math.log2(spec.uv_encoding_size):.6f}",
            f"#define SURFACE_CODES {''.join(f', {_CODES[p]}' for p in spec.encoding_channels)}",
        ]
    included = ["generated header"]

    def include(name: str, depth: int, wanted_by: str) -> None:
        """Append a file and what it includes, unless it is there already."""
        if depth > MAX_DEPTH:
            raise ShaderError(f"shader {name}: includes nest deeper than {MAX_DEPTH}")
        if name in included:
            return
        text = _read(name)
        if text is None:
            raise ShaderError(f"shader {name!r}, wanted by {wanted_by}, does not exist")
        first = len(included) * LINES_PER_FILE
        included.append(name)
        lines.append(f"#line {first + 1}")
        for number, line in enumerate(text.splitlines(), start=1):
            if not line.lstrip().startswith("#include"):
                lines.append(line)
                continue
            place = f"{name}:{number}"
            match = _INCLUDE.match(line)
            if match is None:
                raise ShaderError(f"shader {place}: not an include: {line.strip()!r}")
            if match["file"] is not None:
                include(match["file"], depth + 1, place)
            elif match["name"] in generated:
                lines.append(f"#line {len(included) * LINES_PER_FILE + 1}")
                included.append(f"generated {match['name']}")
                lines.extend(generated[match["name"]].splitlines())
            else:
                raise ShaderError(f"shader {place}: nothing generated for {match['name']}")
            lines.append(f"#line {first + number + 1}")

    include(name, 0, "the renderer")
    return ShaderSource("\n".join(lines) + "\n", tuple(included))


def axis_levels(count: int) -> int:
    """Levels of a table of `count` entries: each has half the entries of the one before, the last
    one has one."""
    return (count - 1).bit_length() + 1


@cache
def _read(name: str) -> str | None:
    # Names come from our own files and code; still, nothing outside the folder is ever read.
    if not re.fullmatch(r"[a-z0-9_]+\.(vert|frag|glsl)", name):
        return None
    file = files("pica_client.render") / "shaders" / name
    return file.read_text(encoding="utf-8") if file.is_file() else None
