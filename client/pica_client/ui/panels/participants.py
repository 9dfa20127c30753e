"""The list of everybody in the room, with a menu for each person, and the code to compare."""

from collections.abc import Collection
from typing import Final

from imgui_bundle import imgui

from pica_client.call.participants import Participant, duration_text
from pica_client.ui.actions import Action, Request
from pica_client.ui.call_view import CallView
from pica_client.ui.panels.side import invitation, side_panel
from pica_client.ui.panels.sound import volume_slider
from pica_client.ui.state import ViewState
from pica_client.ui.surface import icons, widgets
from pica_client.ui.surface.fonts import TEXT_PT
from pica_client.ui.surface.theme import Metrics, Tone
from pica_protocol.messages import BarIdentity, MutePeer, RemovePeer

CODE_PT: Final = 19.0
MENU_PT: Final = 24.0
VOLUME_PT: Final = 180.0
Sign = tuple[str, Tone, str]
"""An icon, its tone, and what it means."""


def participants_panel(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """Who is here, oneself first, then in order of coming."""
    requests: list[Request] = []
    if state.side != "participants":
        return requests
    status = call.status
    speaking = {person.peer_id for person in call.people if person.is_speaking}
    with side_panel("Participants", metrics, requests):
        many = f"{len(status.participants)} in {status.room}, {duration_text(status.duration_s)}"
        widgets.note(many, metrics)
        for person in status.participants:
            requests += _row(person, state, call, metrics, speaking)
        requests += _barred(state, metrics)
        imgui.separator()
        _encryption(call, metrics)
        imgui.separator()
        requests += invitation(status.invitation, metrics)
    return requests


def signs_of(person: Participant, *, is_encrypted: bool, volume: float = 1.0) -> list[Sign]:
    """What is shown beside a name, each with its meaning for who points at it."""
    signs: list[Sign] = []
    if "voice" in person.muted_kinds:
        signs.append((icons.VOICE_OFF, "alert", "An admin has muted the voice"))
    elif person.is_voice_muted:
        signs.append((icons.VOICE_OFF, "alert", "Voice is muted"))
    if volume == 0:
        signs.append((icons.SPEAKER_OFF, "alert", "You have muted this person for yourself"))
    elif volume != 1:
        signs.append((icons.SPEAKER, "plain", f"As loud as {volume:.0%} here"))
    if person.is_recording:
        signs.append((icons.RECORD, "alert", "Keeps what is seen here"))
    if person.face == "muted":
        signs.append((icons.FACE_OFF, "plain", "Face is off"))
    if person.face == "frozen":
        signs.append((icons.FREEZE, "plain", "Face is frozen"))
    if person.is_watching:
        signs.append((icons.WATCHING, "plain", "Watches, and shows no face"))
    if person.is_verified:
        signs.append((icons.LOCK, "good", "Encrypts, and knows the room's secret"))
    elif is_encrypted and not person.is_self:
        signs.append((icons.WARNING, "warning", "Not verified"))
    if person.is_assured:
        signs.append((icons.CHECK, "accent", "The relay vouches for this name"))
    return signs


def _row(
    person: Participant,
    state: ViewState,
    call: CallView,
    metrics: Metrics,
    speaking: Collection[str],
) -> list[Request]:
    """One person: a dot while they speak, the name with its signs, a menu, and what is to say."""
    px, palette, requests = metrics.px, metrics.palette, list[Request]()
    left, top = imgui.get_cursor_pos()
    width, indent = imgui.get_content_region_avail().x, px(20)
    volume = state.volumes.get(person.place, 1.0)
    signs = signs_of(person, is_encrypted=call.status.is_encrypted, volume=volume)
    signs_px = sum(widgets.text_size(icon, TEXT_PT)[0] + px(6) for icon, _, _ in signs)
    name = f"{person.name} (you)" if person.is_self else person.name
    if person.peer_id in speaking:
        place = imgui.get_cursor_screen_pos()
        centre = (place.x + px(7), place.y + widgets.text_size("A", TEXT_PT)[1] / 2)
        widgets.draw_disc(imgui.get_window_draw_list(), centre, px(10), palette.good)
    imgui.set_cursor_pos((left + indent, top))
    imgui.begin_group()
    imgui.push_style_var(imgui.StyleVar_.item_spacing, (px(6), px(2)))
    room = width - indent - signs_px - px(MENU_PT + 8)
    imgui.text_unformatted(widgets.shortened(name, room, TEXT_PT))
    for icon, tone, meaning in signs:
        imgui.same_line()
        imgui.push_style_color(imgui.Col_.text, palette.tone(tone))
        imgui.text_unformatted(icon)
        imgui.pop_style_color()
        widgets.hint(meaning)
    remarks: list[tuple[str, Tone]] = [(person.warning, "warning"), (person.line, "plain")]
    for text, tone in remarks:
        if text:
            widgets.note(text, metrics, tone=tone, wrap_px=width - indent - px(MENU_PT + 8))
    imgui.pop_style_var()
    imgui.end_group()
    after = imgui.get_cursor_pos()
    if not person.is_self:
        imgui.set_cursor_pos((left + width - px(MENU_PT), top - px(3)))
        if widgets.icon_button(icons.MORE, f"More on {person.name}", metrics, size_pt=MENU_PT):
            imgui.open_popup(f"menu {person.peer_id}")
        requests += _menu(person, state, call, metrics)
    imgui.set_cursor_pos((left, max(after.y, top + px(MENU_PT))))
    imgui.dummy((0, 0))
    return requests


def _menu(person: Participant, state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    requests: list[Request] = []
    if imgui.begin_popup(f"menu {person.peer_id}"):
        pin = "Unpin" if state.pinned == person.place else "Pin"
        if not person.is_watching and imgui.menu_item_simple(f"{icons.PIN}  {pin}"):
            state.pin(person.place)
        if imgui.menu_item_simple(f"{icons.CHART}  Statistics"):
            requests.append(Action.STATISTICS)
        if imgui.menu_item_simple(f"{icons.RESET}  Reset the view"):
            requests.append(Action.RESET_VIEW)
        if person.has_voice:
            imgui.separator()
            volume = state.volumes.get(person.place, 1.0)
            is_muted = volume == 0
            icon, what = (
                (icons.SPEAKER, "Hear again") if is_muted else (icons.SPEAKER_OFF, "Mute for me")
            )
            width = metrics.px(VOLUME_PT)
            found = volume_slider("##volume", volume, metrics, width_px=width)
            if imgui.menu_item_simple(f"{icon}  {what}"):
                found = 1.0 if is_muted else 0.0
            if found != volume:
                state.volumes[person.place] = found
        if call.status.is_admin:
            imgui.separator()
            requests += _moderation(person, state)
        imgui.end_popup()
    return requests


def _moderation(person: Participant, state: ViewState) -> list[Request]:
    """What an admin may do to a participant."""
    requests: list[Request] = []
    kinds = (
        ("voice", person.has_voice, icons.VOICE, icons.VOICE_OFF),
        ("face", not person.is_watching, icons.FACE, icons.FACE_OFF),
    )
    for kind, is_sent, on, off in kinds:
        is_muted = kind in person.muted_kinds
        text = f"{on}  Unmute {kind}" if is_muted else f"{off}  Mute {kind}"
        if is_sent and imgui.menu_item_simple(text):
            requests.append(MutePeer(peer_id=person.peer_id, kind=kind, is_muted=not is_muted))
    if imgui.menu_item_simple(f"{icons.REMOVE}  Remove"):
        requests.append(RemovePeer(peer_id=person.peer_id))
    if person.identity and imgui.menu_item_simple(f"{icons.BAR}  Bar until the room is empty"):
        state.barred[person.identity] = person.name
        requests.append(BarIdentity(identity=person.identity, is_barred=True))
    return requests


def _barred(state: ViewState, metrics: Metrics) -> list[Request]:
    """Those whom this admin has barred, each with a button that lifts the bar."""
    requests: list[Request] = []
    for identity, name in tuple(state.barred.items()):
        widgets.note(f"{name} may not rejoin until the room is empty.", metrics)
        if widgets.action_button(f"{icons.RESET}  Let {name} rejoin", metrics):
            del state.barred[identity]
            requests.append(BarIdentity(identity=identity, is_barred=False))
    return requests


def _encryption(call: CallView, metrics: Metrics) -> None:
    """How the encryption stands, with the code in a form that one can read aloud."""
    status = call.status
    if not status.is_encrypted:
        widgets.note("Not encrypted end to end: who runs the relay can read the faces.", metrics)
        return
    if not status.code:
        widgets.note("Encrypted end to end. Nobody else here is verified yet.", metrics)
        return
    widgets.note("Encrypted end to end. Everybody must read the same code:", metrics)
    groups = status.code.split()
    with widgets.type_size(CODE_PT, is_bold=True):
        for begin in range(0, len(groups), 3):
            imgui.text_unformatted("   ".join(groups[begin : begin + 3]))
    widgets.note("If somebody reads another one, the relay shows you different people.", metrics)
