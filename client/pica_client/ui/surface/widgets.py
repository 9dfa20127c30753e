"""What several panels are made of: stock ImGui in the sizes and colours of `style`.

with card("Settings", (x, y)):
    title("Settings")
    if icon_button(icons.ICON_FA_XMARK, "Close", keys="Esc"):
        ...
"""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from typing import TypeVar

import arabic_reshaper
from bidi import get_display
from imgui_bundle import imgui, imgui_ctx

from pica_client.ui.surface import style

FIXED = (
    imgui.WindowFlags_.no_decoration
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_focus_on_appearing
    | imgui.WindowFlags_.no_nav
)
HEBREW = 0x590
"""First code point of the scripts that run from right to left."""
Place = tuple[float, float]
Value = TypeVar("Value")


@contextmanager
def card(
    name: str,
    place: Place,
    *,
    pivot: Place = (0.0, 0.0),
    size: Place | None = None,
    scrolls: bool = False,
    flags: int = FIXED,
) -> Iterator[None]:
    """A panel of its own; without a size it is as large as what is in it.

    Args:
        name: Unique among panels.
        place: Where its pivot is, units.
        pivot: The point of the card at that place, 0 to 1 of its size.
        size: Units; a part that is 0 is as large as what is in it.
        scrolls: Whether what is too high can be scrolled.
        flags: ImGui's, where a panel wants others: without `no_nav` keys move through it.
    """
    imgui.set_next_window_pos(place, imgui.Cond_.always, pivot)
    if size is None:
        flags |= imgui.WindowFlags_.always_auto_resize
    else:
        imgui.set_next_window_size(size)
    if scrolls:
        flags &= ~imgui.WindowFlags_.no_scrollbar
    with imgui_ctx.begin(name, None, flags):
        yield


def type_size(points: float, *, is_bold: bool = False) -> AbstractContextManager[object]:
    """Text of another size, in points."""
    return imgui_ctx.push_font(imgui.get_io().fonts.fonts[1] if is_bold else None, points)


def title(text: str) -> None:
    """The title of a panel."""
    with type_size(style.TITLE_PT, is_bold=True):
        imgui.text_unformatted(text)


def note(text: str, *, tone: style.Tone = "plain", wrap: float = 0.0) -> None:
    """Small faint text; wrapped at the panel's edge, or at so many units."""
    with type_size(style.SMALL_PT):
        imgui.push_style_color(imgui.Col_.text, style.TONES[tone])
        imgui.push_text_wrap_pos(imgui.get_cursor_pos_x() + wrap if wrap else 0.0)
        imgui.text_unformatted(text)
        imgui.pop_text_wrap_pos()
        imgui.pop_style_color()


def icon_button(
    icon: str,
    tooltip: str,
    *,
    keys: str = "",
    tone: style.Tone = "plain",
    size_pt: float = style.BUTTON_PT,
) -> bool:
    """A round button with an icon. Its tooltip names the key that does the same.

    Args:
        tooltip: What it does; unique within its panel.
        tone: "accent" for what is on, "alert" for what ends or warns.
    """
    side = style.px(size_pt)
    imgui.push_style_var(imgui.StyleVar_.frame_rounding, side / 2)
    imgui.push_style_var(imgui.StyleVar_.frame_padding, (0, 0))
    with type_size(0.42 * size_pt):
        is_pressed = _toned_button(f"{icon}##{tooltip}", tone, (side, side))
    imgui.pop_style_var(2)
    hint(f"{tooltip}   [{keys}]" if keys else tooltip)
    return is_pressed


def action_button(label: str, *, tone: style.Tone = "plain", width: float = 0.0) -> bool:
    """A button with words; of the "accent" tone it is what the panel is for."""
    return _toned_button(label, tone, (width, style.px(38)))


def _toned_button(label: str, tone: style.Tone, size: Place) -> bool:
    if tone == "plain":
        return imgui.button(label, size)
    fill = style.TONES[tone]
    lighter = [*(0.88 * part + 0.12 for part in fill[:3]), fill[3]]
    for part, colour in (
        (imgui.Col_.button, fill),
        (imgui.Col_.button_hovered, lighter),
        (imgui.Col_.button_active, fill),
        (imgui.Col_.text, style.ON_ACCENT),
    ):
        imgui.push_style_color(part, colour)
    is_pressed = imgui.button(label, size)
    imgui.pop_style_color(4)
    return is_pressed


def choice_of(label: str, titles: Iterable[tuple[Value, str]], chosen: Value) -> Value:
    """One of several values, each with its title; one that is not among them is shown as it is."""
    known = dict(titles)
    imgui.set_next_item_width(-1)
    if imgui.begin_combo(label, known.get(chosen, str(chosen))):
        for value, name in known.items():
            if imgui.selectable(name, value == chosen)[0]:
                chosen = value
        imgui.end_combo()
    return chosen


def hint(text: str) -> None:
    """Say something of the last widget, above or below it, while the pointer rests on it."""
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    size, middle, gap = imgui.get_io().display_size, (low.x + high.x) / 2, (high.y - low.y) / 4
    is_below = low.y < size.y / 2
    if imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip):
        place = (middle, high.y + gap if is_below else low.y - gap)
        pivot = (middle / size.x, 0.0 if is_below else 1.0)
        imgui.set_next_window_pos(place, imgui.Cond_.always, pivot)
        with type_size(style.SMALL_PT):
            imgui.set_tooltip(text)


def ink(colour: style.Colour) -> int:
    """Return a colour as draw lists take it."""
    return imgui.color_convert_float4_to_u32(colour)


def text_size(text: str, points: float) -> Place:
    """Return the units that a line of text takes."""
    return _text_size(text, points, imgui.get_style().font_scale_dpi)


@lru_cache(maxsize=2048)
def _text_size(text: str, points: float, scale: float) -> Place:
    with type_size(points):
        found = imgui.calc_text_size(text)
    return found.x, found.y


def shortened(text: str, width: float, points: float) -> str:
    """Return a text as it is drawn, no wider than so many units: its end is "…" if it must be."""
    if text_size(text, points)[0] <= width:
        return as_drawn(text)
    low, high = 0, len(text)
    while low < high:
        middle = (low + high + 1) // 2
        if text_size(text[:middle].rstrip() + "…", points)[0] <= width:
            low = middle
        else:
            high = middle - 1
    return as_drawn(text[:low].rstrip() + "…")


@lru_cache(maxsize=1024)
def as_drawn(text: str) -> str:
    """Return a text as glyphs from left to right.

    ImGui sets one glyph beside the other. Hebrew and Arabic are put into that order before, and
    Arabic letters get the shape that their neighbours ask for. Marks of Indian scripts are not
    rearranged.
    """
    if all(ord(char) < HEBREW for char in text):
        return text
    return str(get_display(arabic_reshaper.reshape(text)))
