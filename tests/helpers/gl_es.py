"""Give the decoder's shaders in the browser's dialect to a driver of GL ES 3.0.

Run as a program, for its context would take the place of others in a process. Ends with `UNABLE`
where no such driver is there, and with 1 where it refuses a text.
"""

import ctypes
import sys
from typing import Any

from pica_client.render.gpu_program import compose
from pica_client.render.gpu_tables import GATHER, SHEET, lay_out
from pica_core.avatar.file import load_avatar, shipped_avatar_files

UNABLE = 77
SURFACELESS, OPENGL_ES_API, NONE = 0x31DD, 0x30A0, 0x3038
CONFIG = (0x3040, 0x40, 0x3033, 0, NONE)  # renderable: ES 3; no surface at all
VERSION = (0x3098, 3, NONE)
FRAGMENT_SHADER, VERTEX_SHADER, COMPILE_STATUS = 0x8B30, 0x8B31, 0x8B81


def make_current() -> Any:
    """A context of ES 3 of this thread; gives the library, None where there is none."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return None
    for name in ("eglGetPlatformDisplay", "eglCreateContext", "eglGetProcAddress"):
        getattr(egl, name).restype = ctypes.c_void_p
    display = ctypes.c_void_p(egl.eglGetPlatformDisplay(SURFACELESS, None, None))
    if not egl.eglInitialize(display, None, None) or not egl.eglBindAPI(OPENGL_ES_API):
        return None
    config, count = ctypes.c_void_p(), ctypes.c_int()
    wanted = (ctypes.c_int * len(CONFIG))(*CONFIG)
    egl.eglChooseConfig(display, wanted, ctypes.byref(config), 1, ctypes.byref(count))
    version = (ctypes.c_int * len(VERSION))(*VERSION)
    context = ctypes.c_void_p(egl.eglCreateContext(display, config, None, version))
    return egl if egl.eglMakeCurrent(display, None, None, context) else None


def complaint(egl: Any, kind: int, text: str) -> str:
    """What the driver says against a shader; nothing if it takes it."""

    def call(name: str, *arguments: Any) -> Any:
        return ctypes.CFUNCTYPE(ctypes.c_uint)(egl.eglGetProcAddress(name.encode()))(*arguments)

    shader = call("glCreateShader", kind)
    lines = (ctypes.c_char_p * 1)(text.encode())
    call("glShaderSource", shader, 1, lines, None)
    call("glCompileShader", shader)
    status, log = ctypes.c_int(), ctypes.create_string_buffer(4096)
    call("glGetShaderiv", shader, COMPILE_STATUS, ctypes.byref(status))
    call("glGetShaderInfoLog", shader, len(log), None, log)
    return "" if status.value else log.value.decode() or "no reason given"


def main() -> int:
    """Compile all texts."""
    laid_out = lay_out(load_avatar(shipped_avatar_files()[0]))
    assert laid_out is not None
    egl = make_current()
    if egl is None:
        print("no driver of GL ES 3.0")
        return UNABLE
    plan = laid_out[0]
    exits = [last for _, last in plan.exits.values()]
    texts = [(VERTEX_SHADER, compose("rect.vert", dialect="300 es"))]
    texts += [(FRAGMENT_SHADER, compose(name, dialect="300 es")) for name in (GATHER, SHEET)]
    for step in (*plan.trunk, plan.full, *exits, *plan.vertices):
        source = compose(step.shader, dialect="300 es", defines=step.defines)
        texts.append((FRAGMENT_SHADER, source))
    for kind, source in texts:
        if said := complaint(egl, kind, source):
            print(said)
            return 1
    print(f"{len(texts)} shaders compile")
    return 0


if __name__ == "__main__":
    sys.exit(main())
