"""What stands before the picture when it is new or empty: who is waited for, and a first hint."""

from imgui_bundle import imgui

from pica_client.ui.actions import Request
from pica_client.ui.call_view import CallView
from pica_client.ui.panels.control_bar import BAR_PT, EDGE_PT
from pica_client.ui.panels.side import invitation
from pica_client.ui.state import ViewState
from pica_client.ui.surface.theme import Metrics
from pica_client.ui.surface.widgets import action_button, card, note, title

WAITING_PT = 380.0
HINT_PT = 140.0


def waiting_page(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """While nobody with a face is here: where one is, who watches, and a line to invite others."""
    status = call.status
    is_asked = state.asks_to_leave or (metrics.is_compact and state.side != "none")
    if call.people or not status.room or not status.is_connected or is_asked:
        return []
    requests: list[Request] = []
    columns, rows = metrics.size
    edge = metrics.px(EDGE_PT)
    width = min(metrics.px(WAITING_PT), columns - 2 * edge)
    imgui.set_next_window_size_constraints((width, 0), (width, rows - 2 * edge))
    with card("waiting", (columns / 2, 0.42 * rows), metrics, pivot=(0.5, 0.5), scrolls=True):
        title("Waiting for others")
        watching = len(status.participants) - 1
        note(f"You are in the room {status.room}.", metrics)
        if watching > 0:
            who = "One person watches." if watching == 1 else f"{watching} people watch."
            note(f"{who} Nobody else shows a face.", metrics)
        if call.has_pointer:
            requests += invitation(status.invitation, metrics, "accent")
        else:
            note(status.invitation, metrics, tone="accent")
    return requests


def hint_share(state: ViewState, metrics: Metrics) -> float:
    """The part of the picture's height that the hint takes from the people."""
    if not shows_hint(state) or metrics.is_compact:
        return 0.0
    return metrics.px(HINT_PT) / metrics.size[1]


def shows_hint(state: ViewState) -> bool:
    """Whether it is to be seen."""
    return not state.has_seen_hint and not state.asks_to_leave and state.side == "none"


def first_hint(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """What one needs to know in the first call, until it is dismissed."""
    if not shows_hint(state):
        return []
    requests: list[Request] = []
    edge = metrics.px(EDGE_PT)
    if metrics.is_compact:  # in the line of the signs, where nobody's face is
        small = metrics.px(3)
        imgui.push_style_var(imgui.StyleVar_.window_padding, (edge, small))
        with card("hint", (metrics.size[0] / 2, small), metrics, pivot=(0.5, 0.0)):
            imgui.align_text_to_frame_padding()
            note("Click somebody to see them large", metrics, wrap_px=metrics.size[0])
            imgui.same_line()
            if imgui.small_button("Got it"):
                state.has_seen_hint = True
        imgui.pop_style_var()
        return requests
    place = (metrics.size[0] / 2, metrics.size[1] - 2 * edge - metrics.px(BAR_PT))
    width = min(metrics.px(420), metrics.size[0] - 2 * edge)
    imgui.set_next_window_size_constraints((width, 0), (width, metrics.size[1] - 2 * edge))
    with card("hint", place, metrics, pivot=(0.5, 1.0)):
        lines = [
            "Move the pointer to see the bar. H shows all keys.",
            "Drag to look around, click somebody to see them large.",
        ]
        if state.own_face == "none":
            lines.append("You show no face. Leave, and join with a face source, to be seen.")
        for line in lines:
            note(line, metrics)
        if action_button("Got it", metrics):
            state.has_seen_hint = True
    return requests
