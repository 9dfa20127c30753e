"""A window to show a call in: what the user does in it comes out as events. Thin, over glfw.

    with Window((960, 540)) as window:
        renderer = Renderer(window.context, window.size_px)
        while True:
            for event in window.poll():
                controls.receive(event)
            renderer.resize(window.size_px)
            ...draw...
            window.show(renderer.present)

One window per process; everything on the thread that made it.
"""

from collections.abc import Callable
from typing import Any

import glfw
import moderngl

from pica_client.closing import Closing
from pica_client.ui import events
from pica_client.ui.display import has_display
from pica_core.errors import GraphicsError
from pica_core.gl import GL_VERSION

TITLE = "PiCA Telepresence"
MIN_SIZE = (320, 240)
"""The smallest window, in the screen's units: what the panels are laid out for."""
MAX_EVENTS = 1000
"""Between two polls; what comes beyond is dropped."""
MAX_PASTED = 4096
"""Characters taken from the clipboard at once."""

KEY_NAMES: dict[int, str] = {
    **{getattr(glfw, f"KEY_{letter}"): letter for letter in "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"},
    **{getattr(glfw, f"KEY_KP_{digit}"): digit for digit in "0123456789"},
    **{getattr(glfw, f"KEY_F{number}"): f"F{number}" for number in range(1, 13)},
    **{
        getattr(glfw, f"KEY_{name.upper()}"): name
        for name in (*events.NAMED_KEYS, *events.ARROW_KEYS)
    },
    glfw.KEY_KP_ENTER: "Enter",
    glfw.KEY_EQUAL: "=",
    glfw.KEY_KP_ADD: "+",
    glfw.KEY_MINUS: "-",
    glfw.KEY_KP_SUBTRACT: "-",
}


class Window(Closing):
    """A glfw window with a GL 3.3 context.

    Args:
        size: Columns and rows to open with, in the screen's units; at least `MIN_SIZE`.

    Raises:
        GraphicsError: No display, or no context on it; names the fix.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self._events: list[events.InputEvent] = []
        self._complaint = "glfw gives no reason"
        self._windowed: tuple[int, int, int, int] | None = None
        glfw.set_error_callback(self._note_error)
        if not glfw.init():
            advice = (
                "check that the display server runs, or run with --headless"
                if has_display()
                else "DISPLAY is not set: run it from a desktop session, or with --headless"
            )
            raise GraphicsError(f"no window can be opened ({self._complaint}); {advice}")
        glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, GL_VERSION // 100)
        glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, GL_VERSION % 100 // 10)
        glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
        glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, glfw.TRUE)
        width, height = max(size[0], MIN_SIZE[0]), max(size[1], MIN_SIZE[1])
        self._window: Any = glfw.create_window(width, height, TITLE, None, None)
        if not self._window:
            glfw.terminate()
            raise GraphicsError(
                f"no window with OpenGL {GL_VERSION / 100:.1f} ({self._complaint}); update the "
                "graphics driver, or run with --headless"
            )
        no_limit = glfw.DONT_CARE
        glfw.set_window_size_limits(self._window, *MIN_SIZE, no_limit, no_limit)
        glfw.make_context_current(self._window)
        glfw.swap_interval(1)  # `show` waits for the display
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
        glfw.set_char_callback(
            self._window, lambda _, code: self._note(events.TextTyped(chr(code)))
        )
        glfw.set_scroll_callback(self._window, lambda _, right, up: self._note(events.Scrolled(up)))
        glfw.set_mouse_button_callback(self._window, self._on_button)
        glfw.set_cursor_pos_callback(self._window, self._on_move)

    @property
    def size_px(self) -> tuple[int, int]:
        """Columns and rows of the framebuffer; at least 1 each, also while minimised."""
        width, height = glfw.get_framebuffer_size(self._window)
        return max(width, 1), max(height, 1)

    @property
    def windowed_size(self) -> tuple[int, int] | None:
        """Columns and rows in the screen's units; None in full screen and while minimised."""
        if self._windowed is not None or not self._window:
            return None
        width, height = glfw.get_window_size(self._window)
        return (width, height) if width > 0 and height > 0 else None

    @property
    def content_scale(self) -> float:
        """Pixels a point of the display that the window is on."""
        return max(float(glfw.get_window_content_scale(self._window)[0]), 0.5)

    def poll(self) -> list[events.InputEvent]:
        """What the user did since the last call, in order. Does not wait."""
        glfw.poll_events()
        seen, self._events = self._events, []
        if glfw.window_should_close(self._window):
            seen.append(events.CloseWanted())
        return seen

    def show(self, paint: Callable[[moderngl.Framebuffer], None]) -> None:
        """Have the screen painted; waits for the display if that was asked for."""
        paint(self.context.screen)
        glfw.swap_buffers(self._window)

    def clipboard(self) -> str:
        """The text in the clipboard; empty when there is none."""
        content = glfw.get_clipboard_string(self._window)
        text = content.decode(errors="replace") if isinstance(content, bytes) else content
        return (text or "")[:MAX_PASTED]

    def copy(self, text: str) -> None:
        """Put a text into the clipboard."""
        glfw.set_clipboard_string(self._window, text)

    def close(self) -> None:
        """Close the window and give the display back. Once is enough, twice is harmless."""
        if self._window:
            glfw.destroy_window(self._window)
            self._window = None
            glfw.terminate()

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

    def _note(self, event: events.InputEvent) -> None:
        if len(self._events) < MAX_EVENTS:
            self._events.append(event)

    def _on_key(self, _window: Any, key: int, _code: int, action: int, modifiers: int) -> None:
        name = KEY_NAMES.get(key)
        if name is None:
            return
        held = {
            "has_control": bool(modifiers & (glfw.MOD_CONTROL | glfw.MOD_SUPER)),
            "has_shift": bool(modifiers & glfw.MOD_SHIFT),
        }
        if action == glfw.RELEASE:
            self._note(events.KeyReleased(name, **held))
        else:
            self._note(events.KeyPressed(name, is_repeat=action == glfw.REPEAT, **held))

    def _on_button(self, window: Any, button: int, action: int, _modifiers: int) -> None:
        if button <= glfw.MOUSE_BUTTON_MIDDLE:
            place = self._in_pixels(*glfw.get_cursor_pos(window))
            kind = events.MousePressed if action == glfw.PRESS else events.MouseReleased
            self._note(kind(*place, button))

    def _on_move(self, _window: Any, x: float, y: float) -> None:
        event = events.MouseMoved(*self._in_pixels(x, y))
        if self._events and isinstance(self._events[-1], events.MouseMoved):
            self._events[-1] = event  # fast mice move often; only the last place counts
        else:
            self._note(event)

    def _in_pixels(self, x: float, y: float) -> tuple[float, float]:
        """Turn the screen's units, in which pointers are, into pixels of the picture."""
        width, height = glfw.get_window_size(self._window)
        columns, rows = self.size_px
        return x * columns / max(width, 1), y * rows / max(height, 1)
