"""A window to show a call in, over glfw, and Dear ImGui for it or for a picture.

    with Window((960, 540)) as window:
        window.begin(now)
        control_bar(state, call)
        window.surface.end()
        window.show(paint)

One window per process; everything on the thread that made it. ImGui's own back ends read keyboard,
mouse and clipboard (glfw) and draw (OpenGL). Without a GL context nothing can be drawn, but panels
can be tested. Lengths are the window's own units, which are pixels except where the display server
scales windows itself, as on a Mac.

Latin, Greek and Cyrillic are Roboto, icons are Font Awesome; both come with imgui-bundle. The other
scripts and emoji are subsets of Noto in `font_files`. A glyph is read when it is first needed.
"""

import ctypes
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import imgui_bundle  # names the glfw library that ImGui's back end and ours must share
import moderngl
import numpy as np
from imgui_bundle import imgui

# isort: split
import glfw

from pica_client.system import Closing, has_display
from pica_client.ui.widgets import TEXT_PT, apply_style, scale_for
from pica_core.errors import GraphicsError
from pica_core.gl import GL_VERSION
from pica_core.types import Image

TITLE = "PiCA Telepresence"
MIN_SIZE = (480, 360)
"""The smallest window, in the screen's units."""
ON_PICTURE = "picture "
"""How names of windows begin that are part of the picture, also of one that is kept."""
_BUNDLE = Path(imgui_bundle.__file__).parent / "assets" / "fonts"
_NOTO = {
    "NotoSansCJKsc-common.otf": 1.24,
    "NotoSansArabic.ttf": 1.8,
    "NotoSansHebrew.ttf": 1.16,
    "NotoSansDevanagari.ttf": 1.11,
    "NotoSansThai.ttf": 1.29,
    "NotoSansArmenian.ttf": 1.16,
    "NotoSansGeorgian.ttf": 1.16,
    "NotoEmoji.ttf": 1.0,
}
"""Our fonts, and how much larger each is set: ImGui makes lines of one height, and some of these
fonts have much air in theirs."""


class Surface(Closing):
    """One ImGui context. Several can live side by side; each method makes its own the current one.

    Args:
        context: Where it is painted, GL 3.3, current on this thread; None paints nothing.
        window: Address of the glfw window whose input is taken; None leaves input to tests.
    """

    def __init__(
        self, context: moderngl.Context | None = None, *, window: int | None = None
    ) -> None:
        self._imgui = imgui.create_context()
        self._is_open = True
        self._context, self._window = context, window
        self._textures: dict[str, moderngl.Texture] = {}
        self._last_s: float | None = None
        self._scale = 0.0
        io = self.io
        io.set_ini_filename("")
        io.config_flags |= imgui.ConfigFlags_.nav_enable_keyboard
        _add_fonts(io.fonts)
        if context is None:
            io.backend_flags |= imgui.BackendFlags_.renderer_has_textures
        else:
            imgui.backends.opengl3_init(f"#version {GL_VERSION}")
        if window is not None:
            imgui.backends.glfw_init_for_opengl(window, True)

    def close(self) -> None:
        """Free the context; twice is harmless."""
        if not self._is_open:
            return
        self._is_open = False
        imgui.set_current_context(self._imgui)
        if self._context is not None:
            imgui.backends.opengl3_shutdown()
        if self._window is not None:
            imgui.backends.glfw_shutdown()
        imgui.destroy_context(self._imgui)

    @property
    def io(self) -> imgui.IO:
        """ImGui's input and output of this surface."""
        imgui.set_current_context(self._imgui)
        return imgui.get_io()

    def begin(
        self,
        now: float,
        size: tuple[int, int],
        *,
        content_scale: float = 1.0,
        pixels_a_unit: float = 1.0,
    ) -> None:
        """Begin a frame with the input that has come.

        Args:
            size: Columns and rows, units.
            content_scale: Units a point of this display, and the user's own factor.
        """
        io = self.io
        if self._context is not None:
            imgui.backends.opengl3_new_frame()
        if self._window is not None:
            imgui.backends.glfw_new_frame()
        step_s = 1 / 30 if self._last_s is None else now - self._last_s
        io.delta_time, self._last_s = max(step_s, 1e-4), now
        io.display_size = imgui.ImVec2(*size)
        io.display_framebuffer_scale = imgui.ImVec2(pixels_a_unit, pixels_a_unit)
        scale = scale_for(size, content_scale)
        if scale != self._scale:
            self._scale = scale
            apply_style(scale)
        imgui.new_frame()

    def end(self) -> None:
        """Finish the frame: it can be painted."""
        imgui.set_current_context(self._imgui)
        imgui.render()

    def show(self, name: str, image: Image) -> int:
        """Keep a picture to show in a panel, uint8 ``[H, W, 3]``; see `adopt`."""
        assert self._context is not None
        size = (image.shape[1], image.shape[0])
        texture = self._textures.get(name)
        if texture is None or texture.size != size:
            texture = self._context.texture(size, 3, alignment=1)
        texture.write(np.ascontiguousarray(image), alignment=1)
        return self.adopt(name, texture)

    def adopt(self, name: str, texture: moderngl.Texture) -> int:
        """Keep a texture to show in a panel until another one has its name; return its number,
        which is for `ImTextureRef`."""
        self._textures[name] = texture
        return int(texture.glo)

    def paint(
        self, target: moderngl.Framebuffer, *, signs: bool = True, panels: bool = True
    ) -> None:
        """Blend the last frame over a framebuffer: what is part of the picture, and what is not."""
        imgui.set_current_context(self._imgui)
        data = imgui.get_draw_data()
        before = list(data.cmd_lists)
        data.cmd_lists.clear()
        for each in before:
            if signs if each._owner_name.startswith(ON_PICTURE) else panels:
                data.cmd_lists.push_back(each)
        target.use()
        imgui.backends.opengl3_render_draw_data(data)
        data.cmd_lists.clear()
        for each in before:
            data.cmd_lists.push_back(each)


def _add_fonts(atlas: imgui.ImFontAtlas) -> None:
    """Add all fonts to the atlas of the current context: first plain text, then bold."""
    for name in ("Roboto-Regular.ttf", "Roboto-Bold.ttf"):
        _add(atlas, _BUNDLE / "Roboto" / name)
        # What it lacks is looked for in those that follow.
        _add(atlas, _BUNDLE / "Font_Awesome_6_Free-Solid-900.otf", merge=True)
        for noto, larger in _NOTO.items():
            _add(atlas, Path(__file__).with_name("font_files") / noto, merge=True, larger=larger)


def _add(atlas: imgui.ImFontAtlas, path: Path, *, merge: bool = False, larger: float = 1.0) -> None:
    config = imgui.ImFontConfig()
    config.extra_size_scale = larger
    config.pixel_snap_h = True
    config.merge_mode = merge
    atlas.add_font_from_file_ttf(str(path), TEXT_PT, config)


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
            now, self.size, content_scale=scale * max(points, 0.5) / ratio, pixels_a_unit=ratio
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
