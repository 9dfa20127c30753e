"""One way to get a GL context, with the errors that people really meet."""

from __future__ import annotations

import sys

import moderngl

from pica_core.errors import GraphicsError

GL_VERSION = 330
"""Desktop GL 3.3 core: the oldest version with everything we use."""


def create_context() -> moderngl.Context:
    """Make a headless GL context: EGL on Linux (no X server needed), the platform's own elsewhere.

    Released GL objects are collected by `Context.gc`, which the owner of the context calls between
    frames; a context belongs to the thread that made it.

    Raises:
        GraphicsError: No context, or one older than GL 3.3; the message names the packages or the
            driver to install.
    """
    try:
        if sys.platform == "linux":
            context = moderngl.create_context(require=GL_VERSION, standalone=True, backend="egl")  # type: ignore[arg-type]
        else:
            context = moderngl.create_context(require=GL_VERSION, standalone=True)
    except Exception as error:  # moderngl raises bare Exception for whatever the driver refuses
        raise GraphicsError(
            f"no OpenGL {GL_VERSION / 100:.1f} context ({str(error).strip() or 'no reason given'}); "
            "on Debian or Ubuntu: apt-get install libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri; "
            "elsewhere install or update the graphics driver"
        ) from error
    context.gc_mode = "context_gc"
    return context
