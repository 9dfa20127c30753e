"""The statistics: a table with a line for each participant, and the figures of the whole call.

Columns: the level of detail and what its decode costs; its share of the drawing time; what its
stream takes; how late and how old it is; how much of it had to be made up.
"""

import math

from imgui_bundle import imgui

from pica_client.ui.actions import Request
from pica_client.ui.call_view import CallView, PersonView
from pica_client.ui.panels.control_bar import EDGE_PT
from pica_client.ui.panels.upper_edge import MAX_ROWS, MAX_TABLE_SHARE, signs_share
from pica_client.ui.state import ViewState
from pica_client.ui.surface.theme import SMALL_PT, Metrics
from pica_client.ui.surface.widgets import card, note, shortened, text_size, type_size

HEAD = ("", "level", "decode ms", "draw ms", "kbit/s", "latency ms", "age ms", "concealed")
NO_FIGURE = "–"
NAME_PT = 110.0
MAX_LATENCY_MS = 10_000.0
"""Beyond it sender and receiver have different clocks, and the figure means nothing."""


def statistics(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """The table, at the upper left; what does not fit is scrolled to."""
    if not state.show_statistics:
        return []
    edge = metrics.px(EDGE_PT)
    limit = imgui.ImVec2(metrics.size[0] - 2 * edge, MAX_TABLE_SHARE * metrics.size[1])
    imgui.set_next_window_size_constraints((0, 0), limit)
    imgui.push_style_var(imgui.StyleVar_.window_padding, (metrics.px(12), metrics.px(8)))
    top = edge + signs_share(state, call, metrics) * metrics.size[1]
    with card("statistics", (edge, top), metrics, scrolls=True), type_size(SMALL_PT):
        flags = imgui.TableFlags_.sizing_fixed_fit | imgui.TableFlags_.row_bg
        if imgui.begin_table("figures", len(HEAD), flags):
            for row in (HEAD, *(row_of(person, metrics) for person in call.people[:MAX_ROWS])):
                imgui.table_next_row()
                for number, cell in enumerate(row):
                    imgui.table_next_column()
                    if number:
                        _to_the_right(cell, max(HEAD[number], "0000.0", key=len))
                    if row is HEAD:
                        note(cell, metrics)
                    else:
                        imgui.text_unformatted(cell)
            imgui.end_table()
        note("   ".join(f"{name} {value}".strip() for name, value in call.figures), metrics)
    imgui.pop_style_var()
    return []


def row_of(person: PersonView, metrics: Metrics) -> tuple[str, ...]:
    """The figures of one participant, as the table shows them."""
    found, stream = person.figures, person.stream
    health = stream.health
    bits = None if stream.payload_bps is None else stream.payload_bps / 1e3
    concealed = health.concealed / health.shown * 100 if health.shown else None
    latency = None if found is None else found.latency_ms
    if latency is not None and not 0 <= latency <= MAX_LATENCY_MS:
        latency = None
    level = None if found is None else found.level
    return (
        shortened(person.name, metrics.px(NAME_PT), SMALL_PT),
        figure(level, 0),
        figure(None if found is None else found.decode_ms, 1),
        figure(person.draw_ms, 1),
        figure(bits, 1),
        figure(latency, 0),
        figure(health.age_s * 1e3 if health.shown else None, 0),
        NO_FIGURE if concealed is None else f"{concealed:.1f} %",
    )


def figure(value: float | None, digits: int) -> str:
    """A number as the table shows it."""
    return NO_FIGURE if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def _to_the_right(cell: str, widest: str) -> None:
    """Move a cell to the right edge of its column."""
    free = text_size(widest, SMALL_PT)[0] - text_size(cell, SMALL_PT)[0]
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(free, 0.0))
