"""The bar that steers a call by mouse, and the question whether to leave."""

from itertools import groupby

from imgui_bundle import imgui

from pica_client.ui.actions import ACTIONS, Action, Request, Row
from pica_client.ui.call_view import CallView
from pica_client.ui.state import ViewState
from pica_client.ui.surface.style import BUTTON_PT, EDGE_PT, GAP_PT, px, screen
from pica_client.ui.surface.widgets import action_button, card, icon_button, note, title

BAR_PT = BUTTON_PT + 2 * GAP_PT
SMALLEST_BUTTON_PT = 22.0


def control_bar(state: ViewState, call: CallView) -> list[Request]:
    """Draw the bar at the lower edge while it is to be seen."""
    if not call.shows_bar or state.asks_to_leave:
        return []
    groups = _groups(state)
    gap = px(GAP_PT)
    count = sum(len(group) for group in groups)
    gaps = (count - len(groups)) * gap / 2 + (len(groups) - 1) * 2 * gap + 2 * gap
    side_pt, room = BUTTON_PT, screen()[0] - 2 * px(EDGE_PT)
    while side_pt > SMALLEST_BUTTON_PT and count * px(side_pt) + gaps > room:
        side_pt -= 2
    place = (screen()[0] / 2, screen()[1] - px(EDGE_PT))
    requests: list[Request] = []
    imgui.push_style_var(imgui.StyleVar_.window_padding, (gap, gap))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, (px(side_pt) + 2 * gap) / 2)
    with card("bar", place, pivot=(0.5, 1.0)):
        for number, group in enumerate(groups):
            for at, (action, row) in enumerate(group):
                if number or at:
                    imgui.same_line(0, gap / 2 if at else 2 * gap)
                icon, tip, tone = row.look(state)
                keys = row.key_names[0]
                if icon_button(icon, tip, keys=keys, tone=tone, size_pt=side_pt):
                    requests.append(action)
    imgui.pop_style_var(2)
    return requests


def leave_question(state: ViewState, call: CallView) -> list[Request]:
    """Ask once whether to leave, before the middle of the picture."""
    if not state.asks_to_leave:
        return []
    requests: list[Request] = []
    columns, rows = screen()
    imgui.get_background_draw_list().add_rect_filled((0, 0), (columns, rows), 0x73000000)
    with card("leave", (columns / 2, rows / 2), pivot=(0.5, 0.5)):
        title("Leave the call?")
        note("You can come back at any time.")
        if action_button("Stay", width=px(110)):
            requests.append(Action.CLOSE)
        imgui.same_line()
        if action_button("Leave", tone="alert", width=px(110)):
            state.wants_close = True
        note("Enter leaves, Esc stays")
    return requests


def bar_share() -> float:
    """Return the part of the picture's height that the bar takes from the people."""
    return px(BAR_PT + EDGE_PT) / screen()[1]


def _groups(state: ViewState) -> list[list[tuple[Action, Row]]]:
    """The buttons: own voice and face, the picture, panels, and the way out."""
    found = [
        (action, row)
        for action, row in ACTIONS.items()
        if row.off is not None and row.is_possible(state)
    ]
    found.sort(key=lambda each: each[1].group)
    return [list(group) for _, group in groupby(found, lambda each: each[1].group)]
