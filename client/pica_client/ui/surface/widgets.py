"""The few things that panels are made of, in the project's style.

with card("Settings", (x, y), metrics):
    title("Settings", metrics)
    if icon_button(icons.CLOSE, "Close", metrics, keys="Esc"):
        ...
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from typing import TypeVar

from imgui_bundle import imgui, imgui_ctx

from pica_client.ui.surface import icons, theme
from pica_client.ui.surface.surface import PLAIN
from pica_client.ui.surface.text_order import as_drawn

FIXED = (
    imgui.WindowFlags_.no_decoration
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_focus_on_appearing
    | imgui.WindowFlags_.no_nav
)
_POINTED_AT = imgui.HoveredFlags_.for_tooltip | imgui.HoveredFlags_.allow_when_disabled
Place = tuple[float, float]
Value = TypeVar("Value")
REFERENCE_PX = 64.0
"""The size at which glyphs are measured."""


@contextmanager
def card(
    name: str,
    place: Place,
    metrics: theme.Metrics,
    *,
    pivot: Place = (0.0, 0.0),
    size: Place | None = None,
    scrolls: bool = False,
    flags: int = FIXED,
) -> Iterator[None]:
    """A panel with its own background; without a size it is as large as what is in it.

    Args:
        name: Unique among panels.
        place: Where its pivot is, pixels.
        pivot: The point of the card at that place, 0 to 1 of its size.
        size: Pixels; a part that is 0 is as large as what is in it.
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
    with imgui_ctx.begin(name, None, flags | imgui.WindowFlags_.no_background):
        _ground(metrics.palette)
        yield


def _ground(palette: theme.Palette) -> None:
    """The area of a panel and the line around it; all but its corners is `PLAIN`."""
    shapes, rounding = imgui.get_window_draw_list(), imgui.get_style().window_rounding
    low, size = imgui.get_window_pos(), imgui.get_window_size()
    (left, top), (right, bottom) = low, low + size
    side = min(math.ceil(rounding), size.x / 2, size.y / 2)
    colour, edge = ink(palette.card), ink(_over(palette.line, palette.card))
    shapes.push_clip_rect((left, top), (right, bottom))
    texture = imgui.ImTextureRef(PLAIN)
    x_in, x_out, y_in, y_out = left + side, right - side, top + side, bottom - side
    for corner, end, fill in (
        ((x_in, top), (x_out, top + 1), edge),
        ((x_in, bottom - 1), (x_out, bottom), edge),
        ((left, y_in), (left + 1, y_out), edge),
        ((right - 1, y_in), (right, y_out), edge),
        ((x_in, top + 1), (x_out, y_in), colour),
        ((left + 1, y_in), (right - 1, y_out), colour),
        ((x_in, y_out), (x_out, bottom - 1), colour),
    ):
        shapes.add_image(texture, corner, end, col=fill)
    flags = imgui.ImDrawFlags_
    for x, y, flag in (
        (left, top, flags.round_top_left),
        (x_out, top, flags.round_top_right),
        (left, y_out, flags.round_bottom_left),
        (x_out, y_out, flags.round_bottom_right),
    ):
        inner = max(x, left + 1), max(y, top + 1)
        inner_end = min(x + side, right - 1), min(y + side, bottom - 1)
        shapes.add_rect_filled((x, y), (x + side, y + side), edge, rounding, flag)
        shapes.add_rect_filled(inner, inner_end, colour, rounding - 1, flag)
    shapes.pop_clip_rect()


def _over(upper: theme.Colour, lower: theme.Colour) -> theme.Colour:
    """What is seen of a colour on an opaque one."""
    share = upper[3]
    red, green, blue = (
        share * a + (1 - share) * b for a, b in zip(upper[:3], lower[:3], strict=True)
    )
    return red, green, blue, 1.0


def type_size(points: float, *, is_bold: bool = False) -> AbstractContextManager[object]:
    """Text of another size, in points."""
    return imgui_ctx.push_font(imgui.get_io().fonts.fonts[1] if is_bold else None, points)


def title(text: str) -> None:
    """The title of a panel."""
    with type_size(theme.TITLE_PT, is_bold=True):
        imgui.text_unformatted(text)


def note(
    text: str, metrics: theme.Metrics, *, tone: theme.Tone = "plain", wrap_px: float = 0.0
) -> None:
    """Small faint text; wrapped at the panel's edge, or at so many pixels."""
    with type_size(theme.SMALL_PT):
        imgui.push_style_color(imgui.Col_.text, metrics.palette.tone(tone))
        imgui.push_text_wrap_pos(imgui.get_cursor_pos_x() + wrap_px if wrap_px else 0.0)
        imgui.text_unformatted(text)
        imgui.pop_text_wrap_pos()
        imgui.pop_style_color()


def icon_button(
    icon: str,
    tooltip: str,
    metrics: theme.Metrics,
    *,
    keys: str = "",
    tone: theme.Tone = "plain",
    size_pt: float = theme.BUTTON_PT,
) -> bool:
    """A round button with an icon. Its tooltip names the key that does the same.

    Args:
        tooltip: What it does; unique within its panel.
        tone: "accent" for what is on, "alert" for what ends or warns.
    """
    side = metrics.px(size_pt)
    fill, colour = _button_colours(metrics.palette, tone)
    is_pressed = imgui.invisible_button(f"{icon}##{tooltip}", (side, side))
    if imgui.is_item_hovered():
        fill = _lighter(fill)
    low, shapes = imgui.get_item_rect_min(), imgui.get_window_draw_list()
    middle = (low.x + side / 2, low.y + side / 2)
    draw_disc(shapes, middle, side, fill)
    _draw_icon(shapes, icon, middle, round(0.42 * side), ink(colour))
    hint(f"{tooltip}   [{keys}]" if keys else tooltip)
    return is_pressed


def radio(label: str, metrics: theme.Metrics, *, is_on: bool) -> bool:
    """One of several to choose from; whether it was chosen now. ImGui's own costs four times as
    many triangles."""
    side, gap, palette = metrics.px(18), metrics.px(6), metrics.palette
    width, height = imgui.calc_text_size(label)
    room = imgui.get_frame_height()
    is_pressed = imgui.invisible_button(label, (side + gap + width, room))
    low, shapes = imgui.get_item_rect_min(), imgui.get_window_draw_list()
    middle = (low.x + side / 2, low.y + room / 2)
    is_pointed = imgui.is_item_hovered()
    draw_disc(shapes, middle, side, palette.field_hovered if is_pointed else palette.field)
    if is_on:
        draw_disc(shapes, middle, 0.55 * side, palette.accent)
    place = (low.x + side + gap, low.y + (room - height) / 2)
    shapes.add_text(place, imgui.get_color_u32(imgui.Col_.text), label)
    return is_pressed


def one_of(titles: Mapping[Value, str], chosen: Value, metrics: theme.Metrics) -> Value | None:
    """A few values with their titles, two in a row; gives the one that was chosen now."""
    found = None
    for number, (value, name) in enumerate(titles.items()):
        if number % 2:
            imgui.same_line(metrics.px(130))
        if radio(name, metrics, is_on=value == chosen):
            found = value
    return found


def draw_disc(shapes: imgui.ImDrawList, middle: Place, side: float, colour: theme.Colour) -> None:
    """A disc that is a glyph is round at every size, and has two triangles, not forty: on software
    GL they count most."""
    _draw_icon(shapes, icons.RECORD, middle, side / _icon_box(icons.RECORD, 1.0)[2], ink(colour))


def _draw_icon(
    shapes: imgui.ImDrawList, icon: str, middle: Place, size_px: float, colour: int
) -> None:
    x, y, _ = _icon_box(icon, size_px)
    shapes.add_text(imgui.get_font(), size_px, (middle[0] - x, middle[1] - y), colour, icon)


@lru_cache(maxsize=256)
def _icon_box(icon: str, size_px: float) -> tuple[float, float, float]:
    """The middle of an icon's glyph, from where its text begins, and its width, pixels."""
    scale = size_px / REFERENCE_PX
    glyph = imgui.get_font().get_font_baked(REFERENCE_PX).find_glyph(ord(icon))
    middle = (glyph.x0 + glyph.x1) / 2 * scale, (glyph.y0 + glyph.y1) / 2 * scale
    return *middle, (glyph.x1 - glyph.x0) * scale


def action_button(
    label: str, metrics: theme.Metrics, *, tone: theme.Tone = "plain", width_px: float = 0.0
) -> bool:
    """A button with words; of the "accent" tone it is what the panel is for."""
    fill, text = _button_colours(metrics.palette, tone)
    for part, colour in (
        (imgui.Col_.button, fill),
        (imgui.Col_.button_hovered, _lighter(fill)),
        (imgui.Col_.button_active, fill),
        (imgui.Col_.text, text),
    ):
        imgui.push_style_color(part, colour)
    is_pressed = imgui.button(label, (width_px, metrics.px(38)))
    imgui.pop_style_color(4)
    return is_pressed


def choice_of(label: str, titles: Sequence[tuple[str, str]], chosen: str) -> str:
    """One of several values, each with its title; one that is not among them is shown as it is."""
    imgui.set_next_item_width(-1)
    if imgui.begin_combo(label, dict(titles).get(chosen, chosen)):
        for value, name in titles:
            if imgui.selectable(name, value == chosen)[0]:
                chosen = value
        imgui.end_combo()
    return chosen


def _button_colours(palette: theme.Palette, tone: theme.Tone) -> tuple[theme.Colour, theme.Colour]:
    """The colours of a button, and of what stands on it."""
    if tone == "plain":
        return palette.field, palette.ink
    return palette.tone(tone), palette.on_accent


def _lighter(colour: theme.Colour) -> theme.Colour:
    """What a button is under the pointer."""
    red, green, blue = (0.88 * part + 0.12 for part in colour[:3])
    return red, green, blue, colour[3]


@contextmanager
def ringed() -> Iterator[None]:
    """A field with a ring on its edge while it is typed in; ImGui's own is cut off at a panel's."""
    colour = imgui.get_color_u32(imgui.Col_.nav_cursor)
    imgui.push_style_color(imgui.Col_.nav_cursor, 0)
    try:
        yield
    finally:
        imgui.pop_style_color()
    if imgui.is_item_focused():
        style, shapes = imgui.get_style(), imgui.get_window_draw_list()
        low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        shapes.add_rect(low, high, colour, style.frame_rounding, 1.5 * style.font_scale_dpi)


def hint(text: str) -> None:
    """What is said of the last thing while the pointer rests on it."""
    if imgui.is_item_hovered(_POINTED_AT):
        low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        edge, _ = imgui.get_io().display_size
        with type_size(theme.SMALL_PT):
            padding = imgui.get_style().window_padding.x
            half = imgui.calc_text_size(text).x / 2 + padding
            middle = min(max((low.x + high.x) / 2, half), edge - half)
            imgui.set_next_window_pos((middle, low.y - padding), imgui.Cond_.always, (0.5, 1.0))
            imgui.set_tooltip(text)


def text_size(text: str, points: float) -> Place:
    """Pixels that a line of text takes."""
    return _text_size(text, points, imgui.get_style().font_scale_dpi)


@lru_cache(maxsize=2048)
def _text_size(text: str, points: float, scale: float) -> Place:
    with type_size(points):
        found = imgui.calc_text_size(text)
    return found.x, found.y


def shortened(text: str, width_px: float, points: float) -> str:
    """A text as it is drawn, no wider than so many pixels: its end is "…" if it must be."""
    if text_size(text, points)[0] <= width_px:
        return as_drawn(text)
    low, high = 0, len(text)
    while low < high:
        middle = (low + high + 1) // 2
        if text_size(text[:middle].rstrip() + "…", points)[0] <= width_px:
            low = middle
        else:
            high = middle - 1
    return as_drawn(text[:low].rstrip() + "…")


@lru_cache(maxsize=256)
def ink(colour: theme.Colour) -> int:
    """A colour as draw lists take it."""
    red, green, blue, opacity = (round(255 * part) for part in colour)
    return red | green << 8 | blue << 16 | opacity << 24
