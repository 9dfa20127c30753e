"""Shader programs of the stage, and what they take of vertices and of values."""

import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import moderngl

from pica_core.gl import link_program


def make_program(
    context: moderngl.Context, vertex: str, fragment: str, material: int | None = None
) -> Any:
    """Link two shaders of this package, the fragment shader with ``MATERIAL`` defined."""
    return link_program(
        context,
        vertex=_shader_text(f"{vertex}.vert"),
        fragment=_shader_text(f"{fragment}.frag", material),
    )


def _shader_text(name: str, material: int | None = None) -> str:
    """A shader with its includes resolved (one level)."""
    folder = files("pica_core.capture.stage") / "shaders"
    text = (folder / name).read_text(encoding="utf-8")
    if material is not None:
        text = text.replace("\n", f"\n#define MATERIAL {material}\n#line 2\n", 1)
    return re.sub(
        r'^#include "([\w.]+)"$',
        lambda found: (folder / found.group(1)).read_text(encoding="utf-8"),
        text,
        flags=re.MULTILINE,
    )


def set_uniforms(program: Any, values: Mapping[str, Any]) -> None:
    """Set what the program has of these; the compiler drops what a shader does not need."""
    for name, value in values.items():
        if name in program:
            program[name].value = value


def vertex_array(
    context: moderngl.Context, program: Any, faces: Any, *buffers: tuple[Any, Mapping[str, int]]
) -> Any:
    """Triangles over float32 buffers, each with its layout; a program takes what it has of them."""
    content = []
    for buffer, layout in buffers:
        used = [name for name in layout if name in program]
        parts = [f"{n}f" if name in used else f"{n}x4" for name, n in layout.items()]
        if used:
            content.append((buffer, " ".join(parts), *used))
    return context.vertex_array(program, content, faces)
