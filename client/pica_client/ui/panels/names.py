"""Names under heads, with a sign for who speaks and a line for what is wrong."""

import textwrap

from imgui_bundle import imgui

from pica_client.render.scene import Rect
from pica_client.ui.actions import Request
from pica_client.ui.call_view import CallView, PersonView
from pica_client.ui.state import ViewState
from pica_client.ui.surface import icons
from pica_client.ui.surface.fonts import TEXT_PT
from pica_client.ui.surface.theme import SMALL_PT, Metrics, Tone
from pica_client.ui.surface.widgets import draw_disc, ink, shortened, text_size, type_size

MAX_NOTE_LINES = 3
NOTE_ROOM_PT = 90.0
"""Where there is less room than this, a name is small, and its dot alone says that something is
wrong; the list of participants has the words."""
MIN_ROOM_PT = 48.0
"""A name that would be narrower than this is left out."""


def names(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """Write everybody's name on the picture."""
    for person in call.people:
        if person.label_px is not None:
            _name(person, person.label_px, metrics)
    return []


def least_name_px(metrics: Metrics) -> tuple[float, float]:
    """Columns and rows of the shortest name."""
    return metrics.px(MIN_ROOM_PT), text_size("Ag", TEXT_PT)[1] + metrics.px(6)


def _name(person: PersonView, label_px: Rect, metrics: Metrics) -> None:
    shapes, palette, px = imgui.get_background_draw_list(), metrics.palette, metrics.px
    dot: Tone | None = "good" if person.is_speaking else None
    dot = "alert" if person.stream.quality == "poor" else dot
    left, top, right, bottom = label_px
    room = right - left
    is_narrow = room < px(NOTE_ROOM_PT)
    points = SMALL_PT if is_narrow else TEXT_PT
    pad, gap = (px(5), px(3)) if is_narrow else (px(8), px(6))
    dot_px = px(8) + gap if dot else 0.0
    title = f"{icons.VOICE_OFF} {person.name}" if person.is_voice_muted else person.name
    name = shortened(title, room - dot_px - 2 * pad, points)
    width, height = text_size(name, points)
    line_px = text_size("Ag", SMALL_PT)[1]
    num_lines = 0 if is_narrow else max(int((bottom - top - height - px(6)) / line_px), 0)
    lines = _note_lines(person.remark, room - 2 * pad, min(num_lines, MAX_NOTE_LINES))
    widths = [text_size(line, SMALL_PT)[0] for line in lines]
    plate = max([width + dot_px, *widths]) + 2 * pad
    total = height + len(lines) * line_px + px(6)
    left = (left + right - plate) / 2
    low, high = (left, top), (left + plate, top + total)
    shapes.add_rect_filled(low, high, ink(palette.plate), min(px(10), total / 2))
    x, y = left + (plate - width - dot_px) / 2, top + px(3)
    if dot:
        centre = (x + px(4), y + height / 2)
        draw_disc(shapes, centre, px(8), palette.tone(dot))
    with type_size(points):
        shapes.add_text((x + dot_px, y), ink(palette.ink), name)
    with type_size(SMALL_PT):
        for number, (line, line_width) in enumerate(zip(lines, widths, strict=True)):
            at = (left + (plate - line_width) / 2, y + height + number * line_px)
            shapes.add_text(at, ink(palette.faint), line)


def _note_lines(note: str, width_px: float, num_lines: int) -> list[str]:
    """A note in at most so many lines that are no wider than so many pixels."""
    if not note or not num_lines:
        return []
    wide = max(text_size(note, SMALL_PT)[0] / len(note), 1.0)
    columns = max(int(width_px / wide), 8)
    return textwrap.wrap(note, columns, max_lines=num_lines, placeholder=" …")
