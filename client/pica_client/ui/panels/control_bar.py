"""The bar with which a call is steered by mouse, and the question whether to leave."""

from itertools import groupby

from imgui_bundle import imgui

from pica_client.ui.actions import ACTIONS, Action, Button, Request, is_possible, key_of
from pica_client.ui.call_view import CallView
from pica_client.ui.state import ViewState
from pica_client.ui.surface.theme import BUTTON_PT, GAP_PT, Metrics
from pica_client.ui.surface.widgets import action_button, card, icon_button, note, title

BAR_PT = BUTTON_PT + 2 * GAP_PT
EDGE_PT = 12.0


def control_bar(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """Draw the bar at the lower edge while it is to be seen."""
    if not call.shows_bar or state.asks_to_leave:
        return []
    groups = _groups(state)
    px, gap = metrics.px, metrics.px(GAP_PT)
    count = sum(len(group) for group in groups)
    room = metrics.size[0] - 2 * px(EDGE_PT)
    side_pt = BUTTON_PT
    while side_pt > 22 and _width(count, len(groups), side_pt, metrics) > room:
        side_pt -= 2
    place = (metrics.size[0] / 2, metrics.size[1] - px(EDGE_PT))
    requests: list[Request] = []
    imgui.push_style_var(imgui.StyleVar_.window_padding, (gap, gap))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, (px(side_pt) + 2 * gap) / 2)
    with card("bar", place, metrics, pivot=(0.5, 1.0)):
        for number, group in enumerate(groups):
            for at, (action, button) in enumerate(group):
                if number or at:
                    imgui.same_line(0, gap / 2 if at else 2 * gap)
                icon, tip, tone = button.look(state)
                keys = key_of(action)
                if icon_button(icon, tip, metrics, keys=keys, tone=tone, size_pt=side_pt):
                    requests.append(action)
    imgui.pop_style_var(2)
    return requests


def leave_question(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """Ask once whether to leave, before the middle of the picture."""
    if not state.asks_to_leave:
        return []
    requests: list[Request] = []
    columns, rows = metrics.size
    imgui.get_background_draw_list().add_rect_filled((0, 0), (columns, rows), 0x73000000)
    with card("leave", (columns / 2, rows / 2), metrics, pivot=(0.5, 0.5)):
        title("Leave the call?")
        note("You can come back at any time.", metrics)
        imgui.dummy((0, metrics.px(4)))
        if action_button("Stay", metrics, width_px=metrics.px(110)):
            requests.append(Action.CLOSE)
        imgui.same_line()
        if action_button("Leave", metrics, tone="alert", width_px=metrics.px(110)):
            requests.append(Action.LEAVE)
        note("Enter leaves, Esc stays", metrics)
    return requests


def bar_share(metrics: Metrics) -> float:
    """The part of the picture's height that is kept free for the bar."""
    return min(metrics.px(BAR_PT + EDGE_PT) / metrics.size[1], 0.25)


def _groups(state: ViewState) -> list[list[tuple[Action, Button]]]:
    """The buttons: one's own voice and face, the picture, panels, and the way out."""
    found = [
        (action, row.button)
        for action, row in ACTIONS.items()
        if row.button is not None and is_possible(row, state)
    ]
    found.sort(key=lambda each: each[1].group)
    return [list(group) for _, group in groupby(found, lambda each: each[1].group)]


def _width(count: int, num_groups: int, side_pt: float, metrics: Metrics) -> float:
    gap = metrics.px(GAP_PT)
    inner = (count - num_groups) * gap / 2 + (num_groups - 1) * 2 * gap
    return count * metrics.px(side_pt) + inner + 2 * gap
