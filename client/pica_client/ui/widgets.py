"""What several panels are made of: stock ImGui, in one style of colours, spacing and type sizes.

with card("Settings", (x, y)):
    title("Settings")
    if icon_button(icons.ICON_FA_XMARK, "Close", keys="Esc"):
        ...

Lengths are points; `px` turns them into units of the surface. Type has three sizes: small
(notes, figures), text, and title.
"""

import math
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from typing import Any, Literal, TypeVar

import arabic_reshaper
from bidi import get_display
from imgui_bundle import imgui, imgui_ctx

Tone = Literal["plain", "good", "warning", "alert", "accent"]
Colour = tuple[float, float, float, float]

SMALL_PT, TEXT_PT, TITLE_PT = 12.5, 15.0, 21.0
GAP_PT, PADDING_PT, ROUNDING_PT, EDGE_PT = 8.0, 16.0, 8.0, 12.0
BUTTON_PT = 42.0
"""Height of a button of the control bar: what a finger or a hurried mouse hits."""
BAR_PT = BUTTON_PT + 2 * GAP_PT
REFERENCE_PT = (1280.0, 720.0)
MIN_SCALE, MAX_SCALE = 0.8, 1.75
LEAST_PT = (560.0, 400.0)
"""What the panels are laid out for: on a smaller picture all of it is drawn smaller."""


def _hex(value: str, alpha: float = 1.0) -> Colour:
    red, green, blue = (int(value[at : at + 2], 16) / 255 for at in (0, 2, 4))
    return red, green, blue, alpha


INK, FAINT, CARD = _hex("f1f3f6"), _hex("a7b0bd"), _hex("1a1d23")
PLATE = _hex("101318", 0.78)
"""Under names and notices on the picture."""
FIELD, FIELD_HOVERED, LINE = _hex("2b3039"), _hex("3a414d"), _hex("ffffff", 0.10)
ON_ACCENT = _hex("ffffff")
TONES: dict[Tone, Colour] = {
    "plain": FAINT,
    "good": _hex("4cc38a"),
    "warning": _hex("f2b84b"),
    "alert": _hex("e5484d"),
    "accent": _hex("2f6fed"),
}


def px(points: float) -> float:
    """Return so many points in units of the current surface."""
    return round(points * imgui.get_style().font_scale_dpi)


def screen() -> tuple[float, float]:
    """Return the columns and rows of the current surface, units."""
    size = imgui.get_io().display_size
    return size.x, size.y


def scale_for(size: tuple[int, int], content_scale: float = 1.0) -> float:
    """Return units a point: the display's own scale, and a little more on large pictures."""
    points = min(size[0] / REFERENCE_PT[0], size[1] / REFERENCE_PT[1]) / content_scale
    growth = min(max(math.sqrt(max(points, 1e-6)), MIN_SCALE), MAX_SCALE)
    largest = min(size[0] / LEAST_PT[0], size[1] / LEAST_PT[1])
    return min(content_scale * growth, largest)


def apply_style(scale: float) -> None:
    """Make the style of the current context ours, with so many units a point."""
    style, accent = imgui.get_style(), TONES["accent"]
    style.font_size_base, style.font_scale_dpi = TEXT_PT, scale
    for name in ("window", "child", "popup", "frame", "grab", "scrollbar", "selectable"):
        setattr(style, f"{name}_rounding", px(ROUNDING_PT))
    style.window_rounding = style.popup_rounding = px(1.5 * ROUNDING_PT)
    style.window_border_size = style.popup_border_size = 1.0
    style.frame_border_size = style.child_border_size = 0.0
    style.window_padding = imgui.ImVec2(px(PADDING_PT), px(PADDING_PT))
    style.frame_padding = imgui.ImVec2(px(12), px(8))
    style.item_spacing = imgui.ImVec2(px(GAP_PT), px(GAP_PT))
    style.item_inner_spacing = imgui.ImVec2(px(6), px(6))
    style.cell_padding = imgui.ImVec2(px(8), px(3))
    style.scrollbar_size, style.grab_min_size = px(10), px(14)
    style.window_min_size = imgui.ImVec2(1, 1)
    style.display_safe_area_padding = imgui.ImVec2(0, 0)
    style.hover_delay_normal = 0.35
    style.disabled_alpha = 0.45
    clear = (0.0, 0.0, 0.0, 0.0)
    colours: tuple[tuple[Colour, str], ...] = (
        (INK, "text input_text_cursor"),
        (FAINT, "text_disabled scrollbar_grab_hovered scrollbar_grab_active"),
        (CARD, "window_bg popup_bg"),
        (clear, "child_bg scrollbar_bg tab tab_dimmed"),
        (clear, "tab_selected_overline tab_dimmed_selected_overline"),
        (LINE, "border separator table_border_light"),
        (FIELD, "frame_bg button header checkbox_selected_bg"),
        (FIELD, "tab_selected tab_dimmed_selected table_header_bg"),
        (FIELD_HOVERED, "frame_bg_hovered frame_bg_active button_hovered"),
        (FIELD_HOVERED, "header_hovered tab_hovered scrollbar_grab"),
        (accent, "button_active header_active check_mark slider_grab"),
        (accent, "slider_grab_active nav_cursor text_link"),
        ((*INK[:3], 0.03), "table_row_bg_alt"),
        ((*accent[:3], 0.45), "text_selected_bg"),
    )
    members: Any = imgui.Col_
    for colour, names in colours:
        for name in names.split():
            style.set_color_(getattr(members, name), imgui.ImVec4(*colour))


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
    with type_size(TITLE_PT, is_bold=True):
        imgui.text_unformatted(text)


def note(text: str, *, tone: Tone = "plain", wrap: float = 0.0) -> None:
    """Small faint text; wrapped at the panel's edge, or at so many units."""
    with type_size(SMALL_PT):
        imgui.push_style_color(imgui.Col_.text, TONES[tone])
        imgui.push_text_wrap_pos(imgui.get_cursor_pos_x() + wrap if wrap else 0.0)
        imgui.text_unformatted(text)
        imgui.pop_text_wrap_pos()
        imgui.pop_style_color()


def icon_button(
    icon: str, tooltip: str, *, keys: str = "", tone: Tone = "plain", size_pt: float = BUTTON_PT
) -> bool:
    """A round button with an icon. Its tooltip names the key that does the same.

    Args:
        tooltip: What it does; unique within its panel.
        tone: "accent" for what is on, "alert" for what ends or warns.
    """
    side = px(size_pt)
    imgui.push_style_var(imgui.StyleVar_.frame_rounding, side / 2)
    imgui.push_style_var(imgui.StyleVar_.frame_padding, (0, 0))
    with type_size(0.42 * size_pt):
        is_pressed = _toned_button(f"{icon}##{tooltip}", tone, (side, side))
    imgui.pop_style_var(2)
    hint(f"{tooltip}   [{keys}]" if keys else tooltip)
    return is_pressed


def action_button(label: str, *, tone: Tone = "plain", width: float = 0.0) -> bool:
    """A button with words; of the "accent" tone it is what the panel is for."""
    return _toned_button(label, tone, (width, px(38)))


def _toned_button(label: str, tone: Tone, size: Place) -> bool:
    if tone == "plain":
        return imgui.button(label, size)
    fill = TONES[tone]
    lighter = [*(0.88 * part + 0.12 for part in fill[:3]), fill[3]]
    for part, colour in (
        (imgui.Col_.button, fill),
        (imgui.Col_.button_hovered, lighter),
        (imgui.Col_.button_active, fill),
        (imgui.Col_.text, ON_ACCENT),
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
        with type_size(SMALL_PT):
            imgui.set_tooltip(text)


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
    kept, end = text, ""
    while kept and text_size(kept + end, points)[0] > width:
        kept, end = kept[:-1].rstrip(), "…"
    return as_drawn(kept + end)


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
