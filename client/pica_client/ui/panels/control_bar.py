"""The bar with which a call is steered by mouse, and the question whether to leave."""

from imgui_bundle import imgui

from pica_client.ui.call_view import CallView
from pica_client.ui.controls import KEYS_OF, Order, UserOrder
from pica_client.ui.surface import icons
from pica_client.ui.surface.theme import BUTTON_PT, GAP_PT, Metrics, Tone
from pica_client.ui.surface.widgets import action_button, card, icon_button, note, title

BAR_PT = BUTTON_PT + 2 * GAP_PT
EDGE_PT = 12.0
_Button = tuple[Order, str, str, Tone]
"""What it orders, its icon, its tooltip, its tone."""


def control_bar(view: CallView, metrics: Metrics) -> list[UserOrder]:
    """Draw the bar at the lower edge while it is to be seen."""
    if not view.shows_bar or view.state.asks_to_leave:
        return []
    groups = _groups(view)
    px, gap = metrics.px, metrics.px(GAP_PT)
    count = sum(len(group) for group in groups)
    room = metrics.size[0] - 2 * px(EDGE_PT)
    side_pt = BUTTON_PT
    while side_pt > 22 and _width(count, len(groups), side_pt, metrics) > room:
        side_pt -= 2
    place = (metrics.size[0] / 2, metrics.size[1] - px(EDGE_PT))
    orders: list[UserOrder] = []
    imgui.push_style_var(imgui.StyleVar_.window_padding, (gap, gap))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, (px(side_pt) + 2 * gap) / 2)
    with card("bar", place, metrics, pivot=(0.5, 1.0)):
        for number, group in enumerate(groups):
            for at, (order, icon, tooltip, tone) in enumerate(group):
                if number or at:
                    imgui.same_line(0, gap / 2 if at else 2 * gap)
                keys = KEYS_OF.get(order, "")
                if icon_button(icon, tooltip, metrics, keys=keys, tone=tone, size_pt=side_pt):
                    orders.append(order)
    imgui.pop_style_var(2)
    return orders


def leave_question(view: CallView, metrics: Metrics) -> list[UserOrder]:
    """Ask once whether to leave, before the middle of the picture."""
    if not view.state.asks_to_leave:
        return []
    orders: list[UserOrder] = []
    columns, rows = metrics.size
    imgui.get_background_draw_list().add_rect_filled((0, 0), (columns, rows), 0x73000000)
    with card("leave", (columns / 2, rows / 2), metrics, pivot=(0.5, 0.5)):
        title("Leave the call?")
        note("You can come back at any time.", metrics)
        imgui.dummy((0, metrics.px(4)))
        if action_button("Stay", metrics, width_px=metrics.px(110)):
            orders.append(Order.STAY)
        imgui.same_line()
        if action_button("Leave", metrics, tone="alert", width_px=metrics.px(110)):
            orders.append(Order.LEAVE)
        note("Enter leaves, Esc stays", metrics)
    return orders


def bar_share(metrics: Metrics) -> float:
    """The part of the picture's height that is kept free for the bar."""
    return min(metrics.px(BAR_PT + EDGE_PT) / metrics.size[1], 0.25)


def _groups(view: CallView) -> list[list[_Button]]:
    """The buttons: one's own voice and face, the picture, panels, and the way out."""
    state, keeps = view.state, view.is_recording
    is_hidden, is_frozen = state.own_face == "muted", state.own_face == "frozen"
    is_silent = state.own_voice == "muted"

    def tone(is_so: bool, tone: Tone = "accent") -> Tone:
        return tone if is_so else "plain"

    speak = "Let yourself be heard" if is_silent else "Mute your voice"
    show = "Show your face" if is_hidden else "Hide your face"
    move = "Let your face move" if is_frozen else "Freeze your face"
    record = "Stop recording" if keeps else "Record"
    voice = icons.VOICE_OFF if is_silent else icons.VOICE
    face = icons.FACE_OFF if is_hidden else icons.FACE
    own: list[_Button] = []
    if state.own_voice != "none":
        own.append((Order.MUTE_VOICE, voice, speak, tone(is_silent, "alert")))
    if state.own_face != "none":
        own.append((Order.MUTE_FACE, face, show, tone(is_hidden, "alert")))
        own.append((Order.FREEZE_FACE, icons.FREEZE, move, tone(is_frozen)))
    film = icons.STOP if keeps else icons.RECORD
    picture: list[_Button] = [
        (Order.NEXT_LAYOUT, icons.LAYOUT, "Next layout", "plain"),
        (Order.SCREENSHOT, icons.PICTURE, "Take a picture", "plain"),
        (Order.TOGGLE_RECORDING, film, record, tone(keeps, "alert")),
    ]
    panels: list[_Button] = [
        (Order.PARTICIPANTS, icons.PEOPLE, "Participants", tone(state.side == "participants")),
        (Order.SETTINGS, icons.SETTINGS, "Settings", tone(state.side == "settings")),
        (Order.HELP, icons.HELP, "Help", tone(state.side == "help")),
    ]
    leave: list[_Button] = [(Order.CLOSE, icons.LEAVE, "Leave the call", "alert")]
    return [group for group in (own, picture, panels, leave) if group]


def _width(count: int, num_groups: int, side_pt: float, metrics: Metrics) -> float:
    gap = metrics.px(GAP_PT)
    inner = (count - num_groups) * gap / 2 + (num_groups - 1) * 2 * gap
    return count * metrics.px(side_pt) + inner + 2 * gap
