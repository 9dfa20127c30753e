"""One way to get a GL context, with the errors that people really meet."""

import ctypes
import functools
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, cast

import moderngl

from pica_core.errors import GraphicsError

SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swiftshader")
"""What the names of rasterisers contain that run on the processor."""
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
    options: dict[str, Any] = {"require": GL_VERSION, "standalone": True}
    if sys.platform == "linux":
        options["backend"] = "egl"
    try:
        context = moderngl.create_context(**options)
    except Exception as error:  # moderngl raises bare Exception for whatever the driver refuses
        reason = str(error).strip() or "no reason given"
        raise GraphicsError(
            f"no OpenGL {GL_VERSION / 100:.1f} context ({reason}); "
            "on Debian or Ubuntu: apt-get install libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri; "
            "elsewhere install or update the graphics driver"
        ) from error
    context.gc_mode = "context_gc"
    return context


def is_software(renderer: str) -> bool:
    """Return True if a GL renderer of this name runs on the processor."""
    return any(word in renderer.lower() for word in SOFTWARE_RENDERERS)


def link_program(context: moderngl.Context, *, vertex: str, fragment: str) -> moderngl.Program:
    """Compile and link shaders; Ctrl-C waits until that is done.

    `Context.program` calls back into Python and does not expect an exception from there: one that a
    signal handler raises at that moment ends the process with a segmentation fault.

    Raises:
        moderngl.Error: The driver refuses the text; with its words.
    """
    with _interrupts_held():
        return context.program(vertex_shader=vertex, fragment_shader=fragment)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Let SIGINT and SIGTERM wait for the end of the block; they reach the main thread only."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[tuple[int, FrameType | None]] = []
    handlers = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        handler = signal.getsignal(number)
        if callable(handler):  # what is ignored, or ends the process at once, may do so
            handlers[int(number)] = handler
            signal.signal(number, lambda number, frame: came.append((number, frame)))
    try:
        yield
    finally:
        for held, handler in handlers.items():
            signal.signal(held, handler)
        for caught, frame in came[:1]:
            handlers[caught](caught, frame)


@functools.cache
def _load_finish() -> Callable[[], None] | None:
    """The driver's ``glFinish``, or None where it cannot be found by name."""
    names = {"linux": ("libGL.so.1", "libOpenGL.so.0"), "win32": ("opengl32",)}
    names["darwin"] = ("/System/Library/Frameworks/OpenGL.framework/OpenGL",)
    for name in names.get(sys.platform, ()):
        try:
            finish = ctypes.CDLL(name).glFinish
        except (OSError, AttributeError):
            continue
        finish.argtypes, finish.restype = [], None
        return cast("Callable[[], None]", finish)
    return None


@contextmanager
def freeing(context: moderngl.Context) -> Iterator[None]:
    """Free the GL objects that are dropped within the block, and those that wait in
    `Context.objects`, whatever `gc_mode` the context's owner has chosen.

    By default moderngl frees none. To make it "context_gc" for good would not do in an
    application's context: there `Context.gc` fails at what the application has released itself.
    """
    mode, context.gc_mode = context.gc_mode, "auto"
    try:
        yield
    finally:
        context.gc_mode = mode
        context.gc()


def wait_for_gpu(context: moderngl.Context) -> None:
    """Wait until all drawing of this thread's current context is done, with the GIL released.

    moderngl keeps the GIL while it waits, and with software GL that is the whole time of drawing:
    decoders and network threads of the process would stand still. Foreign calls of ctypes let it
    go. Where the driver's function cannot be found, this falls back to moderngl's own.
    """
    finish = _load_finish() or context.finish
    finish()
