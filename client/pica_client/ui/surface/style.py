"""One style for all of the surface: colours, spacing and type sizes.

Lengths are points; `px` turns them into units of the surface. Type has three sizes: small
(notes, figures), text, and title.
"""

import math
from typing import Any, Literal

from imgui_bundle import imgui

Tone = Literal["plain", "good", "warning", "alert", "accent"]
Colour = tuple[float, float, float, float]

SMALL_PT, TEXT_PT, TITLE_PT = 12.5, 15.0, 21.0
GAP_PT, PADDING_PT, ROUNDING_PT, EDGE_PT = 8.0, 16.0, 8.0, 12.0
BUTTON_PT = 42.0
"""Height of a button of the control bar: what a finger or a hurried mouse hits."""
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
        ((0.0, 0.0, 0.0, 0.45), "modal_window_dim_bg"),
    )
    members: Any = imgui.Col_
    for colour, names in colours:
        for name in names.split():
            style.set_color_(getattr(members, name), imgui.ImVec4(*colour))
