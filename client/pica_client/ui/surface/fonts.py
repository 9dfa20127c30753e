"""The fonts of the surface: one for text, one bold, each with a fallback for every glyph it lacks.

Latin, Greek and Cyrillic are Roboto, icons are Font Awesome; both come with imgui-bundle. The other
scripts and emoji are subsets of Noto in `font_files`. What none of them has is looked for in the
fonts of the machine. A glyph is read and set when it is first needed.
"""

import sys
from pathlib import Path

import imgui_bundle
from imgui_bundle import imgui

TEXT_PT = 15.0
"""Type size of plain text, points."""
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
_SYSTEM = {
    "linux": (
        "/usr/share/fonts/opentype/noto/NotoSansCJK-Regular.ttc",
        "/usr/share/fonts/truetype/dejavu/DejaVuSans.ttf",
    ),
    "win32": (r"C:\Windows\Fonts\msyh.ttc", r"C:\Windows\Fonts\segoeui.ttf"),
    "darwin": ("/System/Library/Fonts/Supplemental/Arial Unicode.ttf",),
}
"""Large fonts of each system, for characters that are in none of ours."""


def add_fonts(atlas: imgui.ImFontAtlas) -> None:
    """Add all fonts to the atlas of the current context: first plain text, then bold."""
    atlas.flags |= imgui.ImFontAtlasFlags_.no_baked_lines  # they would have to be averaged
    for name in ("Roboto-Regular.ttf", "Roboto-Bold.ttf"):
        _add(atlas, _BUNDLE / "Roboto" / name)
        # What it lacks is looked for in those that follow.
        _add(atlas, _BUNDLE / "Font_Awesome_6_Free-Solid-900.otf", merge=True)
        for noto, larger in _NOTO.items():
            _add(atlas, Path(__file__).with_name("font_files") / noto, merge=True, larger=larger)
        for path in map(Path, _SYSTEM.get(sys.platform, ())):
            if path.is_file():
                _add(atlas, path, merge=True)


def _add(atlas: imgui.ImFontAtlas, path: Path, *, merge: bool = False, larger: float = 1.0) -> None:
    config = imgui.ImFontConfig()
    config.extra_size_scale = larger
    config.oversample_h = config.oversample_v = 1
    config.pixel_snap_h = True
    config.merge_mode = merge
    atlas.add_font_from_file_ttf(str(path), TEXT_PT, config)
