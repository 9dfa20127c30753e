"""A window to show a call in, over glfw, with the surface that takes its input.

    with Window((960, 540)) as window:
        window.begin(now)
        ...
        window.surface.end()
        window.show(paint)

One window per process; everything on the thread that made it.
"""

import ctypes
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import imgui_bundle  # names the glfw library that ImGui's back end and ours must share
import moderngl

# isort: split
import glfw

from pica_client.system import Closing, has_display
from pica_client.ui.surface.surface import Surface
from pica_core.errors import GraphicsError
from pica_core.gl import GL_VERSION

assert imgui_bundle
TITLE = "PiCA Telepresence"
MIN_SIZE = (480, 360)
"""The smallest window, in the screen's units."""


class Window(Closing):
    """A glfw window with a GL 3.3 context.

    Args:
        size: Columns and rows to open with, in the screen's units; at least `MIN_SIZE`.

    Raises:
        GraphicsError: No display, or no context on it; names the fix.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self._complaint = "glfw gives no reason"
        self._windowed: tuple[int, int, int, int] | None = None
        glfw.set_error_callback(self._note_error)
        with ExitStack() as stack:
            if not glfw.init():
                advice = (
                    "check that the display server runs, or run with --headless"
                    if has_display()
                    else "DISPLAY is not set: run it from a desktop session, or with --headless"
                )
                raise GraphicsError(f"no window can be opened ({self._complaint}); {advice}")
            stack.callback(glfw.terminate)
            glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, GL_VERSION // 100)
            glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, GL_VERSION % 100 // 10)
            glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
            glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, glfw.TRUE)
            width, height = max(size[0], MIN_SIZE[0]), max(size[1], MIN_SIZE[1])
            self._window: Any = glfw.create_window(width, height, TITLE, None, None)
            if not self._window:
                raise self._no_graphics(self._complaint)
            stack.callback(glfw.destroy_window, self._window)
            glfw.set_window_size_limits(self._window, *MIN_SIZE, glfw.DONT_CARE, glfw.DONT_CARE)
            glfw.make_context_current(self._window)
            glfw.swap_interval(1)  # `show` waits for the display
            try:
                self.context = moderngl.create_context(require=GL_VERSION)
            except Exception as error:  # moderngl raises bare Exception for the driver's refusals
                raise self._no_graphics(str(error)) from error
            self.context.gc_mode = "context_gc"
            handle = ctypes.cast(self._window, ctypes.c_void_p).value
            self.surface = stack.enter_context(Surface(self.context, window=handle))
            self._resources = stack.pop_all()

    def close(self) -> None:
        """Close the window and give the display back; twice is harmless."""
        self._resources.close()
        self._window = None

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows in the screen's units; at least 1 each, also while minimised."""
        width, height = glfw.get_window_size(self._window)
        return max(width, 1), max(height, 1)

    @property
    def size_px(self) -> tuple[int, int]:
        """Columns and rows of the framebuffer; at least 1 each."""
        width, height = glfw.get_framebuffer_size(self._window)
        return max(width, 1), max(height, 1)

    @property
    def windowed_size(self) -> tuple[int, int] | None:
        """Columns and rows in the screen's units; None in full screen and while minimised."""
        if self._windowed is not None or glfw.get_window_attrib(self._window, glfw.ICONIFIED):
            return None
        return self.size

    def poll(self) -> bool:
        """Take what the user did since the last call; return False once they close the window."""
        glfw.poll_events()
        return not glfw.window_should_close(self._window)

    def begin(self, now: float, *, scale: float = 1.0) -> None:
        """Begin a frame of the surface; `scale` is the user's factor for type and buttons."""
        ratio = self.size_px[0] / self.size[0]
        points = glfw.get_window_content_scale(self._window)[0]
        self.surface.begin(
            now,
            self.size,
            content_scale=scale * max(points, 0.5) / ratio,
            pixels_a_unit=ratio,
        )

    def show(self, paint: Callable[[moderngl.Framebuffer], None]) -> None:
        """Have the screen painted; waits for the display if that was asked for."""
        paint(self.context.screen)
        glfw.swap_buffers(self._window)

    def toggle_full_screen(self) -> None:
        """Fill the first monitor, or go back to where the window was."""
        if self._windowed is not None:
            left, top, width, height = self._windowed
            no_monitor: Any = None
            glfw.set_window_monitor(self._window, no_monitor, left, top, width, height, 0)
            self._windowed = None
            return
        monitor = glfw.get_primary_monitor()
        if not monitor:
            return
        self._windowed = (*glfw.get_window_pos(self._window), *glfw.get_window_size(self._window))
        mode = glfw.get_video_mode(monitor)
        glfw.set_window_monitor(
            self._window, monitor, 0, 0, mode.size.width, mode.size.height, mode.refresh_rate
        )

    def _note_error(self, code: int, message: bytes | str) -> None:
        text = message.decode(errors="replace") if isinstance(message, bytes) else message
        self._complaint = f"glfw {code:#x}: {text}"

    def _no_graphics(self, reason: str) -> GraphicsError:
        return GraphicsError(
            f"no window with OpenGL {GL_VERSION / 100:.1f} ({reason}); update the graphics driver, "
            "or run with --headless"
        )
