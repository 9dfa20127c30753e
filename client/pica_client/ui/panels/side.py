"""The panel at the right: its frame, which all that stands in it shares, and the help."""

from collections.abc import Iterator
from contextlib import contextmanager

from imgui_bundle import imgui

from pica_client.ui.actions import Action, Request, help_lines
from pica_client.ui.call_view import CallView
from pica_client.ui.panels.control_bar import BAR_PT, EDGE_PT
from pica_client.ui.state import ViewState
from pica_client.ui.surface import icons
from pica_client.ui.surface.theme import PADDING_PT, Metrics, Tone
from pica_client.ui.surface.widgets import action_button, card, icon_button, note, title

WIDTH_PT = 300.0
CLOSE_PT = 28.0


@contextmanager
def side_panel(name: str, metrics: Metrics, requests: list[Request]) -> Iterator[None]:
    """The frame: a title, a button that closes it, and room that scrolls."""
    edge, (columns, rows) = metrics.px(EDGE_PT), metrics.size
    width = columns - 2 * edge if metrics.is_compact else metrics.px(WIDTH_PT)
    height = rows - edge * 3 - metrics.px(BAR_PT)
    # Only as high as it must be: on software GL a panel costs as much as it covers.
    with card(name, (columns - edge - width, edge), metrics, size=(width, 0)):
        title(name)
        imgui.same_line(imgui.get_window_width() - metrics.px(CLOSE_PT + PADDING_PT))
        if icon_button(icons.CLOSE, "Close", metrics, keys="Esc", size_pt=CLOSE_PT):
            requests.append(Action.CLOSE)
        room = height - imgui.get_cursor_pos_y() - metrics.px(PADDING_PT)
        imgui.set_next_window_size_constraints((0, 0), (columns, max(room, metrics.px(60))))
        imgui.begin_child(f"{name} content", (0, 0), imgui.ChildFlags_.auto_resize_y)
        yield
        imgui.end_child()


def invitation(line: str, metrics: Metrics, tone: Tone = "plain") -> list[Request]:
    """A line that leads others here, and a button that copies it."""
    note("To invite somebody, send them this link.", metrics)
    note(line, metrics, tone="accent")
    is_wanted = action_button(f"{icons.COPY}  Copy the invitation", metrics, tone=tone)
    return [Action.COPY_INVITATION] if is_wanted else []


def side_share(state: ViewState, metrics: Metrics) -> float:
    """The part of the picture's width that the panel takes from the people."""
    if state.side == "none" or metrics.is_compact:
        return 0.0
    return (metrics.px(WIDTH_PT) + 2 * metrics.px(EDGE_PT)) / metrics.size[0]


def help_panel(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """What keys and mouse do."""
    requests: list[Request] = []
    if state.side != "help":
        return requests
    with side_panel("Help", metrics, requests):
        if imgui.begin_table("columns", 2):
            imgui.table_setup_column("first", imgui.TableColumnFlags_.width_fixed)
            imgui.table_setup_column("second", imgui.TableColumnFlags_.width_stretch)
            for keys, meaning in help_lines(state):
                imgui.table_next_row()
                imgui.table_next_column()
                imgui.text_unformatted(keys)
                imgui.table_next_column()
                note(meaning, metrics)
            imgui.end_table()
    return requests
