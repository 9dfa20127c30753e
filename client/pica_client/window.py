"""A window to look at a call: orbit by dragging, zoom by the wheel, and a few keys. Thin, over
glfw.

    with Window("PiCA", (960, 540)) as window:
        renderer = Renderer(window.context, window.size_px)
        while not (state := window.poll()).wants_close:
            renderer.resize(window.size_px)
            ...draw with state.view...
            window.show(renderer)

One window per process; everything on the thread that made it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Self

import glfw
import moderngl

from pica_client.display import has_display
from pica_client.renderer import Renderer
from pica_client.scene import ViewState
from pica_core.errors import GraphicsError
from pica_core.gl import GL_VERSION


@dataclass(frozen=True, kw_only=True, slots=True)
class WindowState:
    """What the user wants, after the last `Window.poll`."""

    view: ViewState = field(default_factory=ViewState)
    show_statistics: bool = False
    show_help: bool = False
    wants_close: bool = False


class Window:
    """A glfw window with a GL 3.3 context.

    Args:
        title: Of the window.
        size: Wished columns and rows, in the screen's units.
        state: What to start with.
        vertical_sync: Wait for the display in `show`.

    Raises:
        GraphicsError: No display, or no context on it; names the fix.
    """

    def __init__(
        self,
        title: str,
        size: tuple[int, int],
        state: WindowState | None = None,
        *,
        vertical_sync: bool = True,
    ) -> None:
        self._state = state or WindowState()
        self._complaint = ""
        self._drag_from: tuple[float, float] | None = None
        self._windowed: tuple[int, int, int, int] | None = None
        glfw.set_error_callback(self._note_error)
        if not glfw.init():
            raise GraphicsError(f"no window can be opened ({self._reason()}); {_display_advice()}")
        glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, GL_VERSION // 100)
        glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, GL_VERSION % 100 // 10)
        glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
        glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, glfw.TRUE)
        self._window: Any = glfw.create_window(*size, title, None, None)
        if not self._window:
            glfw.terminate()
            raise GraphicsError(
                f"no window with OpenGL {GL_VERSION / 100:.1f} ({self._reason()}); update the "
                "graphics driver, or run with --headless"
            )
        glfw.make_context_current(self._window)
        glfw.swap_interval(1 if vertical_sync else 0)
        try:
            self.context = moderngl.create_context(require=GL_VERSION)
        except Exception as error:  # moderngl raises bare Exception for whatever the driver refuses
            self.close()
            raise GraphicsError(
                f"no OpenGL {GL_VERSION / 100:.1f} in the window ({error}); update the graphics "
                "driver, or run with --headless"
            ) from error
        self.context.gc_mode = "context_gc"
        glfw.set_key_callback(self._window, self._on_key)
        glfw.set_scroll_callback(self._window, self._on_scroll)
        glfw.set_mouse_button_callback(self._window, self._on_button)
        glfw.set_cursor_pos_callback(self._window, self._on_move)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def size_px(self) -> tuple[int, int]:
        """Columns and rows of the framebuffer; at least 1 each, also while minimised."""
        width, height = glfw.get_framebuffer_size(self._window)
        return max(width, 1), max(height, 1)

    def poll(self) -> WindowState:
        """Handle what happened since the last call. Does not wait."""
        glfw.poll_events()
        if glfw.window_should_close(self._window):
            self._state = replace(self._state, wants_close=True)
        return self._state

    def show(self, renderer: Renderer) -> None:
        """Put the renderer's image on the screen; waits for the display if that was asked for."""
        renderer.present(self.context.screen)
        glfw.swap_buffers(self._window)

    def close(self) -> None:
        """Close the window and give the display back. Once is enough, twice is harmless."""
        if self._window:
            glfw.destroy_window(self._window)
            self._window = None
            glfw.terminate()

    def _note_error(self, code: int, message: bytes | str) -> None:
        text = message.decode(errors="replace") if isinstance(message, bytes) else message
        self._complaint = f"glfw {code:#x}: {text}"

    def _reason(self) -> str:
        return self._complaint or "glfw gives no reason"

    def _on_key(self, _window: Any, key: int, _code: int, action: int, _mods: int) -> None:
        if action != glfw.PRESS:
            return
        state = self._state
        if key in (glfw.KEY_ESCAPE, glfw.KEY_Q):
            self._state = replace(state, wants_close=True)
        elif key == glfw.KEY_S:
            self._state = replace(state, show_statistics=not state.show_statistics)
        elif key == glfw.KEY_H:
            self._state = replace(state, show_help=not state.show_help)
        elif key == glfw.KEY_R:
            self._state = replace(state, view=ViewState())
        elif key == glfw.KEY_F11:
            self._toggle_fullscreen()

    def _toggle_fullscreen(self) -> None:
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

    def _on_scroll(self, _window: Any, _right: float, up: float) -> None:
        self._state = replace(self._state, view=self._state.view.zoomed(up))

    def _on_button(self, window: Any, button: int, action: int, _mods: int) -> None:
        if button == glfw.MOUSE_BUTTON_LEFT:
            pressed = action == glfw.PRESS
            self._drag_from = glfw.get_cursor_pos(window) if pressed else None

    def _on_move(self, _window: Any, x: float, y: float) -> None:
        if self._drag_from is None:
            return
        right, down = x - self._drag_from[0], y - self._drag_from[1]
        self._drag_from = (x, y)
        self._state = replace(self._state, view=self._state.view.orbited(right, down))


def _display_advice() -> str:
    if has_display():
        return "check that the display server runs, or run with --headless"
    return "DISPLAY is not set: run it from a desktop session, or with --headless"
