"""Dear ImGui without a window: events in, a list of shapes out; `painter` brings them to the GPU.

    surface = Surface((1280, 720))
    surface.receive(MouseMoved(640, 700))
    with surface.frame(now):
        orders = control_bar(view, surface.metrics)
    surface.claims(event)                  # whether it was for the surface, not for the scene

Needs no GL, so panels are tested by feeding events and reading orders. Lengths are pixels of the
picture; the metrics say how many of them a point has.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from imgui_bundle import imgui

from pica_client.ui import events
from pica_client.ui.surface.fonts import add_fonts
from pica_client.ui.surface.theme import Metrics, Mode, apply_theme, metrics_for

BACKGROUND = "##Background"
"""ImGui's name of the list that is drawn below all windows."""
PLAIN = (1 << 31) - 1
"""The number of no texture: what is drawn with it covers what is below it, in one colour. On
software GL that takes a quarter of the time of an area that a texel is looked up for and blended
(measured: 0.17 of 0.65 ms for 300 x 600 pixels)."""
DEFAULT_STEP_S = 1 / 30
MAX_STEP_S = 0.25
"""A frame that took longer than this is not made up for by animations."""
KEYS = {
    **{letter: getattr(imgui.Key, letter.lower()) for letter in "ABCDEFGHIJKLMNOPQRSTUVWXYZ"},
    **{digit: getattr(imgui.Key, f"_{digit}") for digit in "0123456789"},
    **{f"F{number}": getattr(imgui.Key, f"f{number}") for number in range(1, 13)},
    **{name: getattr(imgui.Key, name.lower()) for name in events.NAMED_KEYS},
    **{name: getattr(imgui.Key, f"{name.lower()}_arrow") for name in events.ARROW_KEYS},
}


class Surface:
    """One ImGui context.

    Args:
        size: Columns and rows of the picture, pixels.
        content_scale: Pixels a point of this display; 2 on most HiDPI ones.
    """

    def __init__(
        self, size: tuple[int, int], *, content_scale: float = 1.0, mode: Mode = "dark"
    ) -> None:
        self._context = imgui.create_context()
        self._is_open = True
        self._use()  # a new context is current only where there was none
        io = imgui.get_io()
        io.set_ini_filename("")
        io.backend_flags |= imgui.BackendFlags_.renderer_has_textures
        io.config_input_text_cursor_blink = True
        io.config_flags |= imgui.ConfigFlags_.nav_enable_keyboard
        add_fonts(io.fonts)
        self._last_s: float | None = None
        self.metrics = Metrics(size=(0, 0), scale=1.0, mode=mode)
        self.resize(size, content_scale)

    def close(self) -> None:
        """Free the context; twice is harmless."""
        if self._is_open:
            self._is_open = False
            imgui.destroy_context(self._context)

    def resize(
        self, size: tuple[int, int], content_scale: float = 1.0, mode: Mode | None = None
    ) -> None:
        """Draw for another picture from now on, and in another mode if one is given."""
        metrics = metrics_for(size, content_scale, mode or self.metrics.mode)
        if metrics != self.metrics:
            self._use()
            self.metrics = metrics
            imgui.get_io().display_size = imgui.ImVec2(*size)
            apply_theme(imgui.get_style(), metrics)

    def use_clipboard(self, read: Callable[[], str], write: Callable[[str], None]) -> None:
        """Copy and paste by the system's clipboard, and not by one of its own."""
        self._use()
        platform = imgui.get_platform_io()
        platform.platform_get_clipboard_text_fn = lambda _context: read()
        platform.platform_set_clipboard_text_fn = lambda _context, text: write(text)

    def receive(self, event: events.InputEvent) -> None:
        """Take something that the user did."""
        self._use()
        io = imgui.get_io()
        match event:
            case events.MouseMoved(x_px=x, y_px=y):
                io.add_mouse_pos_event(x, y)
            case events.MousePressed(x_px=x, y_px=y, button=button):
                io.add_mouse_pos_event(x, y)
                io.add_mouse_button_event(button, True)
            case events.MouseReleased(x_px=x, y_px=y, button=button):
                io.add_mouse_pos_event(x, y)
                io.add_mouse_button_event(button, False)
            case events.Scrolled(steps=steps):
                io.add_mouse_wheel_event(0.0, steps)
            case events.TextTyped(text=text):
                io.add_input_characters_utf8(text)
            case events.KeyPressed(is_repeat=False) | events.KeyReleased():
                is_down = isinstance(event, events.KeyPressed)
                io.add_key_event(imgui.Key.mod_ctrl, event.has_control)
                io.add_key_event(imgui.Key.mod_shift, event.has_shift)
                if event.key in KEYS:
                    io.add_key_event(KEYS[event.key], is_down)
            case _:
                pass

    def begin(self, now: float) -> None:
        """Begin a frame with all that was received. From here on `claims` speaks of it."""
        self._use()
        io = imgui.get_io()
        step_s = DEFAULT_STEP_S if self._last_s is None else now - self._last_s
        io.delta_time = min(max(step_s, 1e-4), MAX_STEP_S)
        self._last_s = now
        imgui.new_frame()

    def end(self) -> None:
        """Finish the frame: its shapes can be painted."""
        self._use()
        imgui.render()

    @contextmanager
    def frame(self, now: float) -> Iterator[None]:
        """A whole frame; panels are called within."""
        self.begin(now)
        try:
            yield
        finally:
            self.end()

    def claims(self, event: events.InputEvent) -> bool:
        """Whether an event belongs to the surface: the pointer is on it, or a field is typed in."""
        match event:
            case (
                events.MouseMoved()
                | events.MousePressed()
                | events.MouseReleased()
                | events.Scrolled()
            ):
                return self.wants_mouse
            case events.TextTyped():
                return True
            case events.KeyPressed(key=key) if key != "Escape":
                self._use()
                return bool(imgui.get_io().want_text_input)
        return False

    @property
    def wants_mouse(self) -> bool:
        """Whether the pointer is on the surface, not on the scene."""
        self._use()
        return bool(imgui.get_io().want_capture_mouse)

    def draw_data(self) -> imgui.ImDrawData:
        """The shapes of the last frame."""
        self._use()
        return imgui.get_draw_data()

    def _use(self) -> None:
        imgui.set_current_context(self._context)
