"""What is drawn on the picture itself: names, signs, the user's own face, the bar that steers the
call by mouse, and the question whether to leave."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import groupby

from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from pica_client.call.status import duration_text, joined_names, recorders
from pica_client.render.scene import Rect
from pica_client.render.seats import MAX_FREE, FreeShares
from pica_client.ui.actions import ACTIONS, TALK_KEY, Action, Row
from pica_client.ui.side import side_share
from pica_client.ui.state import CallView, Line, PersonView, ViewState
from pica_client.ui.widgets import (
    BAR_PT,
    EDGE_PT,
    FIXED,
    GAP_PT,
    PLATE,
    SMALL_PT,
    TEXT_PT,
    TONES,
    Place,
    Tone,
    action_button,
    as_drawn,
    card,
    icon_button,
    note,
    px,
    screen,
    shortened,
    text_size,
    title,
    type_size,
)
from pica_client.ui.window import ON_PICTURE

NOTE_ROOM_PT = 90.0
"""With less room than this a name is small, and its dot alone says that something is wrong; the
list of participants has the words."""
MIN_ROOM_PT = 48.0
"""A name that would be narrower than this is left out."""
SIGN_PT = 36.0
"""Height of a sign with the gap below it."""
BESIDE_BAR_PT = 960.0
"""On a narrower picture the own face stands above the bar, not beside it."""
BANNER_AFTER_S = 1.0
"""Suppress the banner for shorter outages."""
OWN_PT, OWN_SHARE = 104.0, 0.15
"""Height of the user's own face, and the part of the picture's that it takes at most."""
ASPECT = 4 / 3
PADDING = (12.0, 6.0)
NAME_PADDING = (8.0, 3.0)
"""Around the text of a sign and of a name, points."""
DOT_PT = 18.0
"""What a dot and the gap behind it take."""
SIGN_FLAGS = FIXED | imgui.WindowFlags_.no_inputs | imgui.WindowFlags_.no_bring_to_front_on_focus


def free_shares(state: ViewState, call: CallView) -> FreeShares:
    """Return the parts of the picture that panels and signs take from the people."""
    return FreeShares(
        top=min(px(SIGN_PT * len(call_signs(call))) / screen()[1], MAX_FREE),
        right=min(side_share(state), MAX_FREE),
        bottom=min(bar_share() if call.has_pointer else 0.0, MAX_FREE),
    )


def names(state: ViewState, call: CallView) -> None:
    """Write the names of all participants on the picture."""
    for person in call.people:
        if person.label is not None:
            _name(person, person.label)


def least_name() -> tuple[float, float]:
    """Return columns and rows of the shortest name, units."""
    return px(MIN_ROOM_PT), text_size("Ag", TEXT_PT)[1] + px(6)


def _name(person: PersonView, label: Rect) -> None:
    """A plate with a dot for speech or a poor connection, a name, and what is wrong below it."""
    tone: Tone = "good" if person.is_speaking else "plain"
    tone = "alert" if person.member.quality == "poor" else tone
    left, top, right, _ = label
    room = right - left - 2 * px(NAME_PADDING[0])
    is_narrow = right - left < px(NOTE_ROOM_PT)
    points = SMALL_PT if is_narrow else TEXT_PT
    shown = person.name
    if person.member.is_voice_muted:
        shown = f"{icons.ICON_FA_MICROPHONE_SLASH} {shown}"
    before = 0 if tone == "plain" else px(DOT_PT)
    name = shortened(shown, room - before, points)
    remark = "" if is_narrow else shortened(person.remark, 2.5 * room, SMALL_PT)
    width = max(text_size(name, points)[0] + before, text_size(remark, SMALL_PT)[0])
    place = ((left + right) / 2, top)
    with _plate(f"name {person.peer_id}", place, (0.5, 0.0), min(width, room)):
        _dotted(name, tone, points)
        if remark:
            note(remark, wrap=room)


@contextmanager
def _plate(
    name: str, place: Place, pivot: Place, width: float, padding: Place = NAME_PADDING
) -> Iterator[None]:
    """A card on the picture for content of a width, which takes no input."""
    imgui.push_style_color(imgui.Col_.window_bg, PLATE)
    across, down = map(px, padding)
    wide = math.ceil(width) + 2 * across
    imgui.set_next_window_size_constraints((wide, 0), (wide, screen()[1]))
    imgui.push_style_var(imgui.StyleVar_.window_padding, (across, down))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, px(14))
    imgui.push_style_var(imgui.StyleVar_.window_border_size, 0)
    imgui.push_style_var(imgui.StyleVar_.item_spacing, (px(6), 0))
    with card(ON_PICTURE + name, place, pivot=pivot, flags=SIGN_FLAGS):
        yield
    imgui.pop_style_var(4)
    imgui.pop_style_color()


def _dotted(text: str, tone: Tone, points: float = TEXT_PT) -> None:
    """A text after a dot of its tone; a plain one has none."""
    with type_size(points):
        if tone != "plain":
            place, height = imgui.get_cursor_screen_pos(), imgui.get_text_line_height()
            centre = (place.x + px(DOT_PT) / 4, place.y + height / 2)
            colour = imgui.color_convert_float4_to_u32(TONES[tone])
            shapes = imgui.get_window_draw_list()
            shapes.add_circle_filled(centre, px(DOT_PT) / 4, colour)
            imgui.dummy((0, height))
            imgui.same_line(0, px(DOT_PT))
        imgui.text_unformatted(text)


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
    is_sent = state.own_face == "sent" and call.status.is_connected
    if is_sent and call.own.is_seen is False:
        found.append(("Your tracker sees no face", "warning"))
    elif is_sent:
        found.append(("Your face is sent", "good"))
    elif state.own_face != "none":
        found.append(("Your face is not sent", "alert"))
    if state.own_voice == "muted":
        found.append(("Your voice is muted", "alert"))
    elif state.own_voice == "sent" and state.sound.push_to_talk:
        key = imgui.get_key_name(TALK_KEY)
        is_heard = state.is_talking
        found.append(("You are heard", "good") if is_heard else (f"Hold {key} to talk", "warning"))
    return found


def signs(state: ViewState, call: CallView) -> None:
    """Write on the picture how the call stands, above, and how the user is sent, below."""
    (columns, _), edge, step = screen(), px(EDGE_PT), px(SIGN_PT)
    for number, line in enumerate(call_signs(call)):
        place = (edge, edge + number * step)
        _sign(f"call {number}", line, place, (0.0, 0.0), columns / 4 - edge)
    found, top = banner(call), edge
    # A notice keeps its window, which knows its height from its second frame on.
    middle = [("banner", found)] if found else []
    for name, line in (*middle, *((line[0], line) for line in call.notices)):
        place = (columns / 2, top)
        top += _sign(name, line, place, (0.5, 0.0), columns / 2) + step / 6
    if state.is_recording:
        place = (columns - edge, _own_bottom())
        _sign("recording", ("Recording", "alert"), place, (1.0, 1.0), columns)
    for number, line in enumerate(own_signs(state, call)):
        place = (edge, _own_bottom() - number * step)
        _sign(f"own {number}", line, place, (0.0, 1.0), columns)


def _sign(name: str, line: Line, place: Place, pivot: Place, width: float) -> float:
    """Draw a pill with a dot and a text, its pivot (0 to 1 of its size) at a place; what is wider
    than so many units is wrapped. Return its height, units."""
    text = as_drawn(line[0])
    content = text_size(text, TEXT_PT)[0] + px(DOT_PT)
    content = min(content, width - 2 * px(PADDING[0]))
    with _plate(f"sign {name}", place, pivot, content, PADDING):
        imgui.push_text_wrap_pos(px(PADDING[0]) + math.ceil(content))
        _dotted(text, line[1])
        imgui.pop_text_wrap_pos()
        return imgui.get_window_height()


def _own_bottom() -> float:
    """Return the lower end of what is shown of the user, units."""
    columns, rows = screen()
    return rows - px(EDGE_PT) - (0.0 if columns >= px(BESIDE_BAR_PT) else bar_share() * rows)


def own_face_height(state: ViewState) -> int:
    """Return how high the picture of the user's own face is, units; 0 without room for it."""
    return round(min(px(OWN_PT), OWN_SHARE * screen()[1])) if state.shows_self else 0


def own_face(state: ViewState, call: CallView) -> None:
    """The user's own face at the lower left, mirrored, and beside it what a camera sees."""
    own, height = call.own, own_face_height(state)
    if not height or (own.texture is None and own.camera is None):
        return
    place = (px(EDGE_PT), _own_bottom() - px(SIGN_PT))
    flags = SIGN_FLAGS | imgui.WindowFlags_.no_background
    imgui.push_style_var(imgui.StyleVar_.window_padding, (0, 0))
    imgui.push_style_var(imgui.StyleVar_.image_rounding, px(8))
    with card("own face", place, pivot=(0.0, 1.0), flags=flags):
        if own.texture is not None:
            # Rows of a GL texture go up; columns go the other way, as in a mirror.
            size = (round(ASPECT * height), height)
            imgui.image(imgui.ImTextureRef(own.texture), size, (1, 1), (0, 0))
            imgui.same_line()
        if own.camera is not None:
            imgui.image(imgui.ImTextureRef(own.camera), (own.aspect * height, height))
    imgui.pop_style_var(2)


def control_bar(state: ViewState, call: CallView) -> None:
    """Draw the bar at the lower edge."""
    if not call.has_pointer or state.asks_to_leave:
        return
    groups = _groups(state)
    gap = px(GAP_PT)
    place = (screen()[0] / 2, screen()[1] - px(EDGE_PT))
    imgui.push_style_var(imgui.StyleVar_.window_padding, (gap, gap))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, px(BAR_PT) / 2)
    with card("bar", place, pivot=(0.5, 1.0)):
        for number, group in enumerate(groups):
            for at, (action, row) in enumerate(group):
                if number or at:
                    imgui.same_line(0, gap / 2 if at else 2 * gap)
                icon, tip, tone = row.look(state)
                keys = row.key_names[0]
                if icon_button(icon, tip, keys=keys, tone=tone):
                    state.requests.append(action)
    imgui.pop_style_var(2)


def leave_question(state: ViewState, call: CallView) -> None:
    """Ask once whether to leave, before the middle of the picture."""
    if not state.asks_to_leave:
        return
    columns, rows = screen()
    imgui.get_background_draw_list().add_rect_filled((0, 0), (columns, rows), 0x73000000)
    with card("leave", (columns / 2, rows / 2), pivot=(0.5, 0.5)):
        title("Leave the call?")
        note("You can come back at any time.")
        if action_button("Stay", width=px(110)):
            state.requests.append(Action.CLOSE)
        imgui.same_line()
        if action_button("Leave", tone="alert", width=px(110)):
            state.wants_close = True
        note("Enter leaves, Esc stays")


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
