"""Dear ImGui for one window or picture: input, fonts, and its way to the GPU.

    with Surface(context, window=handle) as surface:
        surface.begin(now, (1280, 720))
        control_bar(state, call)
        surface.end()
        surface.paint(framebuffer)

ImGui's own back ends read keyboard, mouse and clipboard (glfw) and draw (OpenGL). Without a GL
context nothing can be drawn, but panels can be tested. Lengths are the window's own units, which
are pixels except where the display server scales windows itself, as on a Mac.

Latin, Greek and Cyrillic are Roboto, icons are Font Awesome; both come with imgui-bundle. The other
scripts and emoji are subsets of Noto in `font_files`. A glyph is read when it is first needed.
"""

from pathlib import Path

import imgui_bundle
import moderngl
import numpy as np
from imgui_bundle import imgui

from pica_client.system import Closing
from pica_client.ui.surface.style import TEXT_PT, apply_style, scale_for
from pica_core.gl import GL_VERSION
from pica_core.types import Image

ON_PICTURE = "picture "
"""How names of windows begin that are part of the picture, also of one that is kept."""
MAX_STEP_S = 0.25
"""Animations skip the rest of a frame that took longer than this."""
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
        io.delta_time, self._last_s = min(max(step_s, 1e-4), MAX_STEP_S), now
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
