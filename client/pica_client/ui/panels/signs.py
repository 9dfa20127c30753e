"""Signs on the picture: how the call stands, at the upper edge, and one's own state, below."""

from imgui_bundle import imgui

from pica_client.ui.actions import TALK_KEY, Request
from pica_client.ui.call_view import CallView
from pica_client.ui.panels.upper_edge import SIGN_PT, Line, call_signs, statistics_share
from pica_client.ui.panels.waiting import shows_hint
from pica_client.ui.state import OwnFace, ViewState
from pica_client.ui.surface.fonts import TEXT_PT
from pica_client.ui.surface.theme import Metrics
from pica_client.ui.surface.widgets import Place, draw_disc, ink, shortened, text_size

BANNER_AFTER_S = 1.0
"""Suppress the banner for shorter outages."""
OWN_SIGNS: dict[OwnFace, Line] = {
    "sent": ("Your face is sent", "good"),
    "frozen": ("Your face is frozen", "warning"),
    "muted": ("Your face is not sent", "alert"),
}
RECORDING: Line = ("Recording", "alert")
NO_FACE: Line = ("Your tracker sees no face", "warning")


def banner(call: CallView) -> Line | None:
    """What the user should see: what is wrong with the connection or the own face. At most one."""
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


def own_sign(state: ViewState, call: CallView) -> Line | None:
    """What becomes of the user's own face; None while there is none to send."""
    face: OwnFace = state.own_face if call.status.is_connected else "muted"
    if face == "sent" and call.own.seen is not None and not call.own.seen.has_face:
        return NO_FACE
    return None if state.own_face == "none" else OWN_SIGNS[face]


def voice_sign(state: ViewState) -> Line | None:
    """Whether the user's own voice is heard; None where there is nothing to be said."""
    if state.own_voice == "muted":
        return "Your voice is muted", "alert"
    if state.own_voice == "none" or not state.sound.push_to_talk:
        return None
    if state.is_talking:
        return "You are heard", "good"
    return f"Hold {TALK_KEY} to talk", "warning"


def compact_sign(state: ViewState, call: CallView) -> Line | None:
    """The line that a small picture has room for: what is wrong, news, who records, the room."""
    if shows_hint(state) or state.side != "none":
        return None
    own = [RECORDING] if state.is_recording else []
    room = call_signs(call)
    return banner(call) or next(reversed([*room[:1], *own, *room[1:], *call.notices]), None)


def signs(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """Write the signs on the picture."""
    columns, rows = metrics.size
    edge = metrics.px(12)
    if metrics.is_compact:
        line = compact_sign(state, call)
        if line is not None:
            _sign(line, (columns / 2, metrics.px(4)), (0.5, 0.0), metrics)
        if call.shows_bar:
            return []  # the bar stands there, and its buttons say the same
    else:
        found = banner(call)
        middle = [*([found] if found else []), *call.notices]
        # The table would cover what is beside it.
        below = max(edge, statistics_share(state, call, metrics) * rows)
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
    bottom = rows - edge
    for own in (own_sign(state, call), voice_sign(state)):
        if own is not None:
            _sign(own, (edge, bottom), (0.0, 1.0), metrics)
            bottom -= metrics.px(SIGN_PT)
    if state.is_recording and not metrics.is_compact:
        _sign(RECORDING, (columns - edge, rows - edge), (1.0, 1.0), metrics)
    return []


def _sign(line: Line, place: Place, pivot: Place, metrics: Metrics) -> float:
    """A pill with a dot and a text, its pivot (0 to 1 of its size) at a place; gives its height,
    pixels."""
    shapes, palette, px = imgui.get_background_draw_list(), metrics.palette, metrics.px
    (_, tone), dot, pad = line, px(5), px(12)
    text = _text(line, metrics)
    size = (_width(line, metrics), text_size(text, TEXT_PT)[1] + px(12))
    left, top = place[0] - pivot[0] * size[0], place[1] - pivot[1] * size[1]
    shapes.add_rect_filled(
        (left, top), (left + size[0], top + size[1]), ink(palette.plate), size[1] / 2
    )
    draw_disc(shapes, (left + pad + dot, top + size[1] / 2), 2 * dot, palette.tone(tone))
    shapes.add_text((left + pad + 4 * dot, top + px(6)), ink(palette.ink), text)
    return size[1]


def _text(line: Line, metrics: Metrics) -> str:
    """What there is room for of a text."""
    return shortened(line[0], metrics.size[0] - metrics.px(73), TEXT_PT)


def _width(line: Line, metrics: Metrics) -> float:
    """How wide its pill is, pixels."""
    return text_size(_text(line, metrics), TEXT_PT)[0] + metrics.px(44)
