"""The bar that steers a call by mouse, the question whether to leave, and the first hint."""

from itertools import groupby

from imgui_bundle import imgui

from pica_client.ui.actions import ACTIONS, Action, Request, Row
from pica_client.ui.call_view import CallView
from pica_client.ui.state import ViewState
from pica_client.ui.surface.style import BUTTON_PT, EDGE_PT, GAP_PT, Metrics
from pica_client.ui.surface.widgets import action_button, card, icon_button, note, title

BAR_PT = BUTTON_PT + 2 * GAP_PT
SMALLEST_BUTTON_PT = 22.0
HINT_PT = 140.0


def control_bar(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """Draw the bar at the lower edge while it is to be seen."""
    if not call.shows_bar or state.asks_to_leave:
        return []
    groups = _groups(state)
    px, gap = metrics.px, metrics.px(GAP_PT)
    count = sum(len(group) for group in groups)
    gaps = (count - len(groups)) * gap / 2 + (len(groups) - 1) * 2 * gap + 2 * gap
    side_pt, room = BUTTON_PT, metrics.size[0] - 2 * px(EDGE_PT)
    while side_pt > SMALLEST_BUTTON_PT and count * px(side_pt) + gaps > room:
        side_pt -= 2
    place = (metrics.size[0] / 2, metrics.size[1] - px(EDGE_PT))
    requests: list[Request] = []
    imgui.push_style_var(imgui.StyleVar_.window_padding, (gap, gap))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, (px(side_pt) + 2 * gap) / 2)
    with card("bar", place, metrics, pivot=(0.5, 1.0)):
        for number, group in enumerate(groups):
            for at, (action, row) in enumerate(group):
                if number or at:
                    imgui.same_line(0, gap / 2 if at else 2 * gap)
                icon, tip, tone = row.look(state)
                keys = row.key_names[0]
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
        if action_button("Stay", metrics, width=metrics.px(110)):
            requests.append(Action.CLOSE)
        imgui.same_line()
        if action_button("Leave", metrics, tone="alert", width=metrics.px(110)):
            requests.append(Action.LEAVE)
        note("Enter leaves, Esc stays", metrics)
    return requests


def first_hint(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """What a user needs to know in the first call, until it is dismissed."""
    if not shows_hint(state):
        return []
    edge, (columns, rows) = metrics.px(EDGE_PT), metrics.size
    if metrics.is_compact:  # in the line of the signs, where there is no face
        small = metrics.px(3)
        imgui.push_style_var(imgui.StyleVar_.window_padding, (edge, small))
        with card("hint", (columns / 2, small), metrics, pivot=(0.5, 0.0)):
            imgui.align_text_to_frame_padding()
            note("Click a person to see them large", metrics, wrap=columns)
            imgui.same_line()
            state.has_seen_hint = imgui.small_button("Got it")
        imgui.pop_style_var()
        return []
    width = min(metrics.px(420), columns - 2 * edge)
    imgui.set_next_window_size_constraints((width, 0), (width, rows - 2 * edge))
    place = (columns / 2, rows - 2 * edge - metrics.px(BAR_PT))
    with card("hint", place, metrics, pivot=(0.5, 1.0)):
        note("Move the pointer to see the bar. H shows all keys.", metrics)
        note("Drag to look around, click a person to see them large.", metrics)
        if state.own_face == "none":
            note("You show no face. Leave, and join with a face source, to be seen.", metrics)
        state.has_seen_hint = action_button("Got it", metrics)
    return []


def shows_hint(state: ViewState) -> bool:
    """Return True while the hint is to be seen."""
    return not state.has_seen_hint and not state.asks_to_leave and state.side == "none"


def lower_share(state: ViewState, call: CallView, metrics: Metrics) -> float:
    """Return the part of the picture's height that bar and hint take from the people."""
    height = metrics.size[1]
    bar = min(metrics.px(BAR_PT + EDGE_PT) / height, 0.25) if call.has_pointer else 0.0
    has_hint = shows_hint(state) and not metrics.is_compact
    return bar + (metrics.px(HINT_PT) / height if has_hint else 0.0)


def _groups(state: ViewState) -> list[list[tuple[Action, Row]]]:
    """The buttons: own voice and face, the picture, panels, and the way out."""
    found = [
        (action, row)
        for action, row in ACTIONS.items()
        if row.off is not None and row.is_possible(state)
    ]
    found.sort(key=lambda each: each[1].group)
    return [list(group) for _, group in groupby(found, lambda each: each[1].group)]
