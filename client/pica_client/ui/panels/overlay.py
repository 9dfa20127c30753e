"""What is drawn on the picture itself: names, signs, the user's own face, and the statistics.

Columns of the statistics: the level of detail and what its decode costs; what its stream takes; how
late and how old it is; how much of it had to be concealed.
"""

import math
import textwrap

from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from pica_client.call.participants import duration_text, joined_names, recorders
from pica_client.publish.face_controls import TrackerPreview
from pica_client.render.scene import Rect
from pica_client.render.seats import MAX_FREE, FreeShares
from pica_client.ui.actions import TALK_KEY, Request
from pica_client.ui.call_view import CallView, PersonView
from pica_client.ui.panels.bar import lower_share
from pica_client.ui.panels.side import side_share
from pica_client.ui.state import OwnFace, ViewState
from pica_client.ui.surface.style import EDGE_PT, SMALL_PT, TEXT_PT, Metrics, Tone
from pica_client.ui.surface.widgets import (
    FIXED,
    Place,
    card,
    ink,
    note,
    shortened,
    text_size,
    type_size,
)

MAX_NOTE_LINES = 3
NOTE_ROOM_PT = 90.0
"""With less room than this a name is small, and its dot alone says that something is wrong; the
list of participants has the words."""
MIN_ROOM_PT = 48.0
"""A name that would be narrower than this is left out."""
SIGN_PT = 36.0
"""Height of a sign with the gap below it."""
MAX_ROWS = 16
"""Participants that the table of statistics shows."""
MAX_TABLE_SHARE = 0.45
"""Part of the picture's height that the table takes at most."""
COLUMNS = ("", "level", "decode ms", "kbit/s", "latency ms", "age ms", "concealed")
NO_FIGURE = "–"
NAME_PT = 110.0
MAX_LATENCY_MS = 10_000.0
"""Beyond it sender and receiver have different clocks, and the figure means nothing."""
BANNER_AFTER_S = 1.0
"""Suppress the banner for shorter outages."""
OWN_PT, SMALL_OWN_PT = 104.0, 64.0
"""Height of the user's own face; the smaller one beside a panel while a participant is pinned,
whose shoulder is there then."""
ASPECT = 4 / 3
BARS_PT, BAR_PT = 132.0, 44.0
"""Width of the tracker's values, and of a bar in them."""
Line = tuple[str, Tone]
OWN_SIGNS: dict[OwnFace, Line] = {
    "sent": ("Your face is sent", "good"),
    "frozen": ("Your face is frozen", "warning"),
    "muted": ("Your face is not sent", "alert"),
}
RECORDING: Line = ("Recording", "alert")
NO_FACE: Line = ("Your tracker sees no face", "warning")


def free_shares(state: ViewState, call: CallView, metrics: Metrics) -> FreeShares:
    """Return the parts of the picture that panels and signs take from the people."""
    top = max(_signs_share(call, metrics), _statistics_share(state, call, metrics))
    return FreeShares(
        top=min(top, MAX_FREE),
        right=min(side_share(state, metrics), MAX_FREE),
        bottom=min(lower_share(call, metrics), MAX_FREE),
    )


def names(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """Write the names of all participants on the picture."""
    for person in call.people:
        if person.label is not None:
            _name(person, person.label, metrics)
    return []


def least_name(metrics: Metrics) -> tuple[float, float]:
    """Return columns and rows of the shortest name, units."""
    return metrics.px(MIN_ROOM_PT), text_size("Ag", TEXT_PT)[1] + metrics.px(6)


def _name(person: PersonView, label: Rect, metrics: Metrics) -> None:
    """A plate with a dot for speech or a poor connection, a name, and a line for what is wrong."""
    shapes, palette, px = imgui.get_background_draw_list(), metrics.palette, metrics.px
    dot: Tone | None = "good" if person.is_speaking else None
    dot = "alert" if person.stream.quality == "poor" else dot
    left, top, right, bottom = label
    room = right - left
    is_narrow = room < px(NOTE_ROOM_PT)
    points = SMALL_PT if is_narrow else TEXT_PT
    pad, gap = (px(5), px(3)) if is_narrow else (px(8), px(6))
    before = px(8) + gap if dot else 0.0
    title = person.name
    if person.is_voice_muted:
        title = f"{icons.ICON_FA_MICROPHONE_SLASH} {title}"
    name = shortened(title, room - before - 2 * pad, points)
    width, height = text_size(name, points)
    row = text_size("Ag", SMALL_PT)[1]
    num_lines = 0 if is_narrow else max(int((bottom - top - height - px(6)) / row), 0)
    lines = _note_lines(person.remark, room - 2 * pad, min(num_lines, MAX_NOTE_LINES))
    widths = [text_size(line, SMALL_PT)[0] for line in lines]
    plate = max([width + before, *widths]) + 2 * pad
    total = height + len(lines) * row + px(6)
    left = (left + right - plate) / 2
    ground = ink(palette.plate)
    shapes.add_rect_filled((left, top), (left + plate, top + total), ground, min(px(10), total / 2))
    x, y = left + (plate - width - before) / 2, top + px(3)
    if dot:
        shapes.add_circle_filled((x + px(4), y + height / 2), px(4), ink(palette.tone(dot)))
    with type_size(points):
        shapes.add_text((x + before, y), ink(palette.ink), name)
    with type_size(SMALL_PT):
        for number, (line, line_width) in enumerate(zip(lines, widths, strict=True)):
            at = (left + (plate - line_width) / 2, y + height + number * row)
            shapes.add_text(at, ink(palette.faint), line)


def _note_lines(text: str, width: float, num_lines: int) -> list[str]:
    """Return a note in at most so many lines that are no wider than so many units."""
    if not text or not num_lines:
        return []
    wide = max(text_size(text, SMALL_PT)[0] / len(text), 1.0)
    return textwrap.wrap(text, max(int(width / wide), 8), max_lines=num_lines, placeholder=" …")


def call_signs(call: CallView) -> list[Line]:
    """Return the room and the duration, whether faces are encrypted, and who records."""
    status = call.status
    if not status.room:
        return []
    lock = f"{icons.ICON_FA_LOCK}  " if status.is_encrypted else ""
    where = f"{lock}{status.room}   {duration_text(status.duration_s)}"
    found: list[Line] = [(where, "good" if status.is_connected else "alert")]
    recording = recorders(each for each in status.participants if not each.is_self)
    if recording:
        verb = "records" if len(recording) == 1 else "record"
        found.append((f"{joined_names(recording)} {verb}", "alert"))
    return found


def banner(call: CallView) -> Line | None:
    """Return what is wrong with the connection or the own face, if anything; at most one line."""
    status = call.status
    if not status.is_connected and status.away_s >= BANNER_AFTER_S:
        return f"Connection lost – coming back … {status.away_s:.0f} s", "alert"
    if status.muted_by_admin:
        return f"An admin has muted your {status.muted_by_admin}", "warning"
    if status.own_trouble:
        return status.own_trouble, "warning"
    if status.own_quality == "poor":
        return "Your connection is poor", "warning"
    return None


def own_signs(state: ViewState, call: CallView) -> list[Line]:
    """Return how the user's own face and voice are sent; nothing of what there is none of."""
    found: list[Line] = []
    face: OwnFace = state.own_face if call.status.is_connected else "muted"
    if face == "sent" and call.own.seen is not None and not call.own.seen.has_face:
        found.append(NO_FACE)
    elif state.own_face != "none":
        found.append(OWN_SIGNS[face])
    if state.own_voice == "muted":
        found.append(("Your voice is muted", "alert"))
    elif state.own_voice == "sent" and state.sound.push_to_talk:
        key = imgui.get_key_name(TALK_KEY)
        is_heard = state.is_talking
        found.append(("You are heard", "good") if is_heard else (f"Hold {key} to talk", "warning"))
    return found


def signs(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """Write on the picture how the call stands, above, and how the user is sent, below."""
    (columns, rows), edge = metrics.size, metrics.px(EDGE_PT)
    found = banner(call)
    middle = [*([found] if found else []), *call.notices]
    # The table would cover what is beside it.
    below = max(edge, _statistics_share(state, call, metrics) * rows)
    left = call_signs(call)
    if any(
        _width(one, metrics) + _width(two, metrics) / 2 > columns / 2 - edge
        for one in left
        for two in middle
    ):
        below = max(below, edge + len(left) * metrics.px(SIGN_PT))
    for across, top, pivot, lines in (
        (edge, edge, 0.0, left),
        (columns / 2, below, 0.5, middle),
    ):
        for line in lines:
            top += _sign(line, (across, top), (pivot, 0.0), metrics) + metrics.px(6)
    if state.is_recording:
        _sign(RECORDING, (columns - edge, rows - edge), (1.0, 1.0), metrics)
    for number, line in enumerate(own_signs(state, call)):
        _sign(line, (edge, rows - edge - number * metrics.px(SIGN_PT)), (0.0, 1.0), metrics)
    return []


def _sign(line: Line, place: Place, pivot: Place, metrics: Metrics) -> float:
    """Draw a pill with a dot and a text, its pivot (0 to 1 of its size) at a place; return its
    height, units."""
    shapes, palette, px = imgui.get_background_draw_list(), metrics.palette, metrics.px
    text, dot, pad = _text(line, metrics), px(5), px(12)
    width, height = _width(line, metrics), text_size("Ag", TEXT_PT)[1] + px(12)
    left, top = place[0] - pivot[0] * width, place[1] - pivot[1] * height
    ground = ink(palette.plate)
    shapes.add_rect_filled((left, top), (left + width, top + height), ground, height / 2)
    middle = (left + pad + dot, top + height / 2)
    shapes.add_circle_filled(middle, dot, ink(palette.tone(line[1])))
    shapes.add_text((left + pad + 4 * dot, top + px(6)), ink(palette.ink), text)
    return height


def _text(line: Line, metrics: Metrics) -> str:
    """Return as much of a text as there is room for."""
    return shortened(line[0], metrics.size[0] - metrics.px(73), TEXT_PT)


def _width(line: Line, metrics: Metrics) -> float:
    """Return how wide its pill is, units."""
    return text_size(_text(line, metrics), TEXT_PT)[0] + metrics.px(44)


def _signs_share(call: CallView, metrics: Metrics) -> float:
    """Return the part of the picture's height that the signs at the upper left take."""
    return metrics.px(SIGN_PT * len(call_signs(call))) / metrics.size[1]


def own_face_height(state: ViewState, metrics: Metrics) -> int:
    """Return how high the picture of the user's own face is, units; 0 without room for it."""
    if not state.shows_self:
        return 0
    is_small = state.side != "none" and state.pinned is not None
    return round(metrics.px(SMALL_OWN_PT if is_small else OWN_PT))


def own_face(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """The user's own face at the lower left, mirrored, and beside it what the tracker sees."""
    own, px, palette = call.own, metrics.px, metrics.palette
    height, edge = own_face_height(state, metrics), px(EDGE_PT)
    if not height or (own.texture is None and own.seen is None):
        return []
    width, rounding = round(ASPECT * height), px(8)
    bottom = metrics.size[1] - edge - px(8) - text_size("Ag", TEXT_PT)[1] - px(12)
    flags = FIXED | imgui.WindowFlags_.no_inputs | imgui.WindowFlags_.no_background
    imgui.push_style_var(imgui.StyleVar_.window_padding, (0, 0))
    with card("own face", (edge, bottom), metrics, pivot=(0.0, 1.0), flags=flags):
        low = imgui.get_cursor_screen_pos()
        high = (low.x + width, low.y + height)
        shapes = imgui.get_window_draw_list()
        imgui.dummy((width, height))
        if own.texture is not None:
            texture = imgui.ImTextureRef(own.texture)
            # Rows of a GL texture go up; columns go the other way, as in a mirror.
            shapes.add_image_rounded(texture, low, high, (1, 1), (0, 0), 0xFFFFFFFF, rounding)
        shapes.add_rect(low, high, ink(palette.line), rounding, thickness=px(2))
        if state.own_face in ("muted", "frozen"):
            shapes.add_rect_filled(low, high, ink(palette.plate), rounding)
            text = "off" if state.own_face == "muted" else "frozen"
            columns, rows = text_size(text, TEXT_PT)
            at = (low.x + (width - columns) / 2, low.y + (height - rows) / 2)
            shapes.add_text(at, ink(palette.ink), text)
        if own.camera is not None and own.seen is not None and own.seen.picture is not None:
            imgui.same_line()
            rows, columns = own.seen.picture.shape[:2]
            imgui.image(imgui.ImTextureRef(own.camera), (columns / rows * height, height))
        elif own.seen is not None and height >= px(OWN_PT):
            imgui.same_line()
            _tracked(own.seen, height, metrics)
    imgui.pop_style_var()
    return []


def _tracked(seen: TrackerPreview, height: float, metrics: Metrics) -> None:
    """Some values of the tracker; without a face it says so."""
    palette, px = metrics.palette, metrics.px
    imgui.push_style_color(imgui.Col_.child_bg, palette.plate)
    imgui.push_style_color(imgui.Col_.plot_histogram, palette.good)
    imgui.push_style_var(imgui.StyleVar_.window_padding, (px(8), px(4)))
    imgui.push_style_var(imgui.StyleVar_.item_spacing, (0, 0))
    padded = imgui.ChildFlags_.always_use_window_padding
    imgui.begin_child("tracked", (px(BARS_PT), height), padded)
    line = (height - px(8)) / max(len(seen.bars), 1)
    if not seen.has_face:
        note("no face", metrics, tone="warning")
    for number, (name, value) in enumerate(seen.bars if seen.has_face else ()):
        imgui.set_cursor_pos_y(px(4) + number * line)
        note(name, metrics)
        imgui.same_line(px(BARS_PT - BAR_PT - 8))
        imgui.set_cursor_pos_y(px(4) + (number + 0.5) * line - px(3))
        imgui.progress_bar(min(max(value, 0.0), 1.0), (px(BAR_PT), px(6)), "")
    imgui.end_child()
    imgui.pop_style_var(2)
    imgui.pop_style_color(2)


def statistics(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """A line for each participant, and the figures of the whole call; more can be scrolled to."""
    if not state.show_statistics:
        return []
    edge = metrics.px(EDGE_PT)
    limit = (metrics.size[0] - 2 * edge, MAX_TABLE_SHARE * metrics.size[1])
    imgui.set_next_window_size_constraints((0, 0), limit)
    imgui.push_style_var(imgui.StyleVar_.window_padding, (edge, metrics.px(8)))
    top = edge + _signs_share(call, metrics) * metrics.size[1]
    with card("statistics", (edge, top), metrics, scrolls=True), type_size(SMALL_PT):
        flags = imgui.TableFlags_.sizing_fixed_fit | imgui.TableFlags_.row_bg
        if imgui.begin_table("figures", len(COLUMNS), flags):
            for row in (COLUMNS, *(row_of(each, metrics) for each in call.people[:MAX_ROWS])):
                imgui.table_next_row()
                for number, cell in enumerate(row):
                    imgui.table_next_column()
                    if number:
                        _to_the_right(cell, max(COLUMNS[number], "0000.0", key=len))
                    if row is COLUMNS:
                        note(cell, metrics)
                    else:
                        imgui.text_unformatted(cell)
            imgui.end_table()
        note("   ".join(f"{name} {value}".strip() for name, value in call.figures), metrics)
    imgui.pop_style_var()
    return []


def row_of(person: PersonView, metrics: Metrics) -> tuple[str, ...]:
    """Return the figures of one participant, as the table shows them."""
    found, stream, health = person.figures, person.stream, person.stream.health
    latency = None if found is None else found.latency_ms
    if latency is not None and not 0 <= latency <= MAX_LATENCY_MS:
        latency = None
    concealed = health.concealed / health.shown * 100 if health.shown else None
    return (
        shortened(person.name, metrics.px(NAME_PT), SMALL_PT),
        _figure(None if found is None else found.level, 0),
        _figure(None if found is None else found.decode_ms, 1),
        _figure(None if stream.payload_bps is None else stream.payload_bps / 1e3, 1),
        _figure(latency, 0),
        _figure(health.age_s * 1e3 if health.shown else None, 0),
        NO_FIGURE if concealed is None else f"{concealed:.1f} %",
    )


def _figure(value: float | None, digits: int) -> str:
    return NO_FIGURE if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def _to_the_right(cell: str, widest: str) -> None:
    """Move a cell to the right edge of its column."""
    free = text_size(widest, SMALL_PT)[0] - text_size(cell, SMALL_PT)[0]
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(free, 0.0))


def _statistics_share(state: ViewState, call: CallView, metrics: Metrics) -> float:
    """Return the part of the picture's height that the table, and the signs above it, take."""
    if not state.show_statistics:
        return 0.0
    edge = metrics.px(EDGE_PT)
    rows = min(len(call.people), MAX_ROWS) + 3
    table = rows * metrics.px(1.35 * SMALL_PT + 6) + edge
    table = min(table, MAX_TABLE_SHARE * metrics.size[1])
    return (table + edge) / metrics.size[1] + _signs_share(call, metrics)
