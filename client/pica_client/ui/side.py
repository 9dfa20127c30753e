"""The panel at the right with help, settings or participants, and the waiting page. The microphone
is also chosen in the form that begins a call."""

from collections.abc import Sequence
from dataclasses import replace

from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from pica_client.call.roster import Member
from pica_client.call.status import duration_text
from pica_client.sources.source import PERFORMANCES
from pica_client.ui import widgets
from pica_client.ui.actions import TALK_KEY, Action, help_lines
from pica_client.ui.state import LAYOUT_TITLES, SCALES, CallView, ViewState
from pica_client.ui.widgets import (
    BAR_PT,
    EDGE_PT,
    PADDING_PT,
    TEXT_PT,
    TONES,
    Tone,
    choice_of,
    note,
    px,
    screen,
)
from pica_client.voice.sound.settings import DeviceState, SoundState
from pica_protocol.messages import BarIdentity, MutePeer, RemovePeer

NO_VOICE, MICROPHONE = "none", "mic"
"""Voices, as `voice.source.open_voice` names them."""
SOFTEST_DB, LOUD_DB = 60, 4
"""Where a meter begins, and what is too loud: decibels below full scale."""
MAX_PERCENT = 200
SYSTEMS_OWN = "The system's"
SOURCES: tuple[tuple[str, str], ...] = (
    *((f"performance:{name}", f"Play: {name}") for name in PERFORMANCES),
    ("livelink", "iPhone: Live Link Face"),
    ("vmc", "VTuber program: VMC"),
    ("webcam", "Webcam"),
    ("voice", "None: my voice moves the mouth"),
    ("", "Watch only"),
)
"""Face sources to choose from, and what they are called."""


def settings_tabs(state: ViewState, call: CallView) -> None:
    """The user's identity and sound, and how the call is shown: a tab for each that there is."""
    if imgui.begin_tab_bar("parts"):
        if state.own_face != "none" and imgui.begin_tab_item("You")[0]:
            _you(state, call)
            imgui.end_tab_item()
        if call.sound is not None and imgui.begin_tab_item("Sound")[0]:
            _sound(state, call.sound)
            imgui.end_tab_item()
        if imgui.begin_tab_item("View")[0]:
            _shown(state)
            imgui.end_tab_item()
        imgui.end_tab_bar()


def microphone_picker(state: ViewState, sound: SoundState, *, may_be_off: bool = False) -> None:
    """Choose whose voice is sent, and by which microphone."""
    voice, settings = state.voice, state.sound
    chosen = f"{voice}:{settings.microphone}" if voice == MICROPHONE else voice
    devices = _devices(sound.microphones, settings.microphone, f"{MICROPHONE}:")
    off = ((NO_VOICE, "Off: only listen"),) if may_be_off else ()
    state.voice, _, device = choice_of("##microphone", (*off, *devices), chosen).partition(":")
    if state.voice == MICROPHONE:
        state.sound = replace(settings, microphone=device)


def _sound(state: ViewState, sound: SoundState) -> None:
    """Devices with their meters, volume and switches."""
    settings = state.sound
    if state.own_voice != "none" and state.voice == MICROPHONE:
        note("Microphone")
        microphone_picker(state, sound)
        settings = state.sound
        _meter(sound.microphone_level, sound.microphone)
        if sound.cleaning:
            note(sound.cleaning[0].upper() + sound.cleaning[1:])
        else:
            _, cleans = imgui.checkbox("Take out echo and noise", settings.cleans)
            settings = replace(settings, cleans=cleans)
        label = f"Hold {imgui.get_key_name(TALK_KEY)} to talk"
        _, is_held = imgui.checkbox(label, settings.push_to_talk)
        settings = replace(settings, push_to_talk=is_held)
    note("Loudspeaker")
    devices = _devices(sound.speakers, settings.speaker)
    settings = replace(settings, speaker=choice_of("##speaker", devices, settings.speaker))
    _meter(sound.speaker_level, sound.speaker)
    state.sound = replace(settings, volume=volume_slider("##volume", settings.volume))


def volume_slider(label: str, volume: float, *, width: float = -1.0) -> float:
    """Choose how loud a sound is, 0 to twice as loud as it comes."""
    percent = round(100 * volume)
    note(f"Volume {percent} %")
    imgui.set_next_item_width(width)
    has_changed, percent = imgui.slider_int(label, percent, 0, MAX_PERCENT, "")
    return min(max(percent, 0), MAX_PERCENT) / 100 if has_changed else volume


def _devices(names: Sequence[str], chosen: str, prefix: str = "") -> list[tuple[str, str]]:
    """Return values and titles to choose from; an absent device is marked as such."""
    found = [(prefix, SYSTEMS_OWN), *((prefix + name, name) for name in names)]
    if chosen and chosen not in names:
        found.append((prefix + chosen, f"{chosen} (not there)"))
    return found


def _meter(level: int, device: DeviceState) -> None:
    """A bar as long as the sound is loud, and what is wrong with its device."""
    share = min(max((SOFTEST_DB - level) / SOFTEST_DB, 0.0), 1.0)
    tone: Tone = "warning" if level < LOUD_DB else "good"
    imgui.push_style_color(imgui.Col_.plot_histogram, TONES[tone])
    imgui.progress_bar(share, (-1, px(6)), "")
    imgui.pop_style_color()
    if device.note:
        note(device.note, tone="warning")


def _you(state: ViewState, call: CallView) -> None:
    """The face's source."""
    note("Your face")
    before = call.own.source or state.source
    source = choice_of("##source", [each for each in SOURCES if each[0]], before)
    if source != before:
        state.source = source


def _shown(state: ViewState) -> None:
    """How people sit, and how the surface looks."""
    note("People sit")
    layout = choice_of("##layout", LAYOUT_TITLES.items(), state.layout)
    if layout != state.layout:
        state.requests.append(state.seat(layout))
    note("Size of type and buttons")
    state.scale = choice_of("##scale", [(each, f"{each:.0%}") for each in SCALES], state.scale)
    if state.own_face != "none":
        _, state.shows_self = imgui.checkbox("My own face", state.shows_self)


WIDTH_PT = 300.0
WAITING_PT = 380.0
CLOSE_PT = 28.0
CODE_PT = 19.0
MENU_PT = 24.0
VOLUME_PT = 180.0
Sign = tuple[str, Tone, str]
"""An icon, its tone, and what it means."""


def side_panel(state: ViewState, call: CallView) -> None:
    """Draw the panel that is open: a title, a button that closes it, and room that scrolls."""
    if state.side == "none":
        return
    edge, (columns, rows), name = px(EDGE_PT), screen(), state.side.title()
    width, height = px(WIDTH_PT), rows - edge * 3 - px(BAR_PT)
    with widgets.card(name, (columns - edge - width, edge), size=(width, 0)):
        widgets.title(name)
        imgui.same_line(imgui.get_window_width() - px(CLOSE_PT + PADDING_PT))
        close = icons.ICON_FA_XMARK
        if widgets.icon_button(close, "Close", keys="Esc", size_pt=CLOSE_PT):
            state.requests.append(Action.CLOSE)
        room = height - imgui.get_cursor_pos_y() - px(PADDING_PT)
        imgui.set_next_window_size_constraints((0, 0), (columns, max(room, px(60))))
        imgui.begin_child(f"{name} content", (0, 0), imgui.ChildFlags_.auto_resize_y)
        match state.side:
            case "help":
                _help(state)
            case "settings":
                settings_tabs(state, call)
            case "participants":
                _participants(state, call)
        imgui.end_child()


def side_share(state: ViewState) -> float:
    """Return the part of the picture's width that the panel takes from the people."""
    if state.side == "none":
        return 0.0
    return (px(WIDTH_PT) + 2 * px(EDGE_PT)) / screen()[0]


def _help(state: ViewState) -> None:
    """What keys and mouse do."""
    if imgui.begin_table("columns", 2):
        imgui.table_setup_column("keys", imgui.TableColumnFlags_.width_fixed)
        imgui.table_setup_column("meaning", imgui.TableColumnFlags_.width_stretch)
        for keys, meaning in help_lines(state):
            imgui.table_next_column()
            imgui.text_unformatted(keys)
            imgui.table_next_column()
            widgets.note(meaning)
        imgui.end_table()


def waiting_page(state: ViewState, call: CallView) -> None:
    """Where the user is, and an invitation, until the first face comes."""
    status = call.status
    if call.people or not status.room or not status.is_connected or state.asks_to_leave:
        return
    (columns, rows), edge = screen(), px(EDGE_PT)
    width = min(px(WAITING_PT), columns - 2 * edge)
    imgui.set_next_window_size_constraints((width, 0), (width, rows - 2 * edge))
    place = (columns / 2, 0.42 * rows)
    with widgets.card("waiting", place, pivot=(0.5, 0.5), scrolls=True):
        widgets.title("Waiting for others")
        widgets.note(f"You are in the room {status.room}.")
        _invitation(state, status.invitation, "accent")


def _invitation(state: ViewState, line: str, tone: Tone = "plain") -> None:
    """A link that leads others here, and a button that copies it."""
    widgets.note("To invite others, send them this link.")
    widgets.note(line, tone="accent")
    label = f"{icons.ICON_FA_COPY}  Copy the invitation"
    if widgets.action_button(label, tone=tone):
        state.requests.append(Action.COPY_INVITATION)


def _participants(state: ViewState, call: CallView) -> None:
    """All participants, the user first, then in order of coming."""
    status = call.status
    many = f"{len(status.participants)} in {status.room}, {duration_text(status.duration_s)}"
    widgets.note(many)
    if imgui.begin_table("people", 3):
        fixed = imgui.TableColumnFlags_.width_fixed
        imgui.table_setup_column("speaks", fixed, px(10))
        imgui.table_setup_column("person", imgui.TableColumnFlags_.width_stretch)
        imgui.table_setup_column("menu", fixed, px(MENU_PT) + 2)
        for person in status.participants:
            _row(person, state, call)
        imgui.end_table()
    _barred(state)
    imgui.separator()
    _encryption(call)
    imgui.separator()
    _invitation(state, status.invitation)


def signs_of(person: Member, *, is_encrypted: bool, volume: float = 1.0) -> list[Sign]:
    """Return what is shown beside a name."""
    is_muted_by_admin = "voice" in person.muted_kinds
    is_unverified = is_encrypted and not person.is_verified and not person.is_self
    mute = icons.ICON_FA_MICROPHONE_SLASH
    loud = icons.ICON_FA_VOLUME_HIGH if volume else icons.ICON_FA_VOLUME_XMARK
    rows: tuple[tuple[bool, str, Tone, str], ...] = (
        (is_muted_by_admin, mute, "alert", "An admin has muted the voice"),
        (person.is_voice_muted and not is_muted_by_admin, mute, "alert", "Voice is muted"),
        (volume != 1, loud, "plain", f"As loud as {volume:.0%} here"),
        (person.is_recording, icons.ICON_FA_CIRCLE, "alert", "Keeps what is seen here"),
        (person.face == "muted", icons.ICON_FA_EYE_SLASH, "plain", "Face is off"),
        (person.is_watching, icons.ICON_FA_EYE, "plain", "Watches, and shows no face"),
        (person.is_verified, icons.ICON_FA_LOCK, "good", "Encrypts, and knows the room's secret"),
        (is_unverified, icons.ICON_FA_TRIANGLE_EXCLAMATION, "warning", "Not verified"),
        (person.peer.is_name_assured, icons.ICON_FA_CHECK, "accent", "The relay checked the name"),
    )
    return [(icon, tone, meaning) for is_shown, icon, tone, meaning in rows if is_shown]


def _row(person: Member, state: ViewState, call: CallView) -> None:
    """One person: a dot while they speak, the name with its signs and remarks, and a menu."""
    volume = state.volumes.get(person.place, 1.0)
    signs = signs_of(person, is_encrypted=call.status.is_encrypted, volume=volume)
    gap = px(6)
    signs_width = sum(widgets.text_size(icon, TEXT_PT)[0] + gap for icon, _, _ in signs)
    imgui.table_next_row(0, px(MENU_PT + 6))
    imgui.table_next_column()
    lower = imgui.get_cursor_pos_y() + px(3)  # in the middle of the button's height
    imgui.set_cursor_pos_y(lower + px(3))
    speaks = any(each.peer_id == person.peer_id and each.is_speaking for each in call.people)
    with widgets.type_size(10):
        imgui.text_colored(TONES["good"], icons.ICON_FA_CIRCLE if speaks else "")
    imgui.table_next_column()
    imgui.set_cursor_pos_y(lower)
    imgui.push_style_var(imgui.StyleVar_.item_spacing, (gap, px(2)))
    room = imgui.get_content_region_avail().x
    name = f"{person.name} (you)" if person.is_self else person.name
    imgui.text_unformatted(widgets.shortened(name, room - signs_width, TEXT_PT))
    for icon, tone, meaning in signs:
        imgui.same_line()
        imgui.text_colored(TONES[tone], icon)
        widgets.hint(meaning)
    remarks: list[tuple[str, Tone]] = [(person.warning, "warning"), (person.line, "plain")]
    for text, tone in remarks:
        if text:
            widgets.note(text, tone=tone, wrap=room)
    imgui.pop_style_var()
    imgui.table_next_column()
    if not person.is_self:
        more = f"More on {person.name}"
        if widgets.icon_button(icons.ICON_FA_ELLIPSIS_VERTICAL, more, size_pt=MENU_PT):
            imgui.open_popup(f"menu {person.peer_id}")
        _menu(person, state, call)


def _menu(person: Member, state: ViewState, call: CallView) -> None:
    if imgui.begin_popup(f"menu {person.peer_id}"):
        pin = "Unpin" if state.pinned == person.place else "Pin"
        if not person.is_watching and _item(icons.ICON_FA_THUMBTACK, pin):
            state.pin(person.place)
        if _item(icons.ICON_FA_ROTATE_LEFT, "Reset the view"):
            state.requests.append(Action.RESET_VIEW)
        if person.has_voice:
            imgui.separator()
            before = state.volumes.get(person.place, 1.0)
            volume = volume_slider("##volume", before, width=px(VOLUME_PT))
            if volume != before:
                state.volumes[person.place] = volume
        if call.status.is_admin:
            imgui.separator()
            _moderation(person, state)
        imgui.end_popup()


def _item(icon: str, text: str) -> bool:
    return imgui.menu_item_simple(f"{icon}  {text}")


def _moderation(person: Member, state: ViewState) -> None:
    """What an admin may do to a participant."""
    kinds = (
        ("voice", person.has_voice, icons.ICON_FA_MICROPHONE, icons.ICON_FA_MICROPHONE_SLASH),
        ("face", not person.is_watching, icons.ICON_FA_FACE_SMILE, icons.ICON_FA_EYE_SLASH),
    )
    for kind, is_sent, on, off in kinds:
        is_muted = kind in person.muted_kinds
        icon, text = (on, f"Unmute {kind}") if is_muted else (off, f"Mute {kind}")
        if is_sent and _item(icon, text):
            state.requests.append(
                MutePeer(peer_id=person.peer_id, kind=kind, is_muted=not is_muted)
            )
    if _item(icons.ICON_FA_USER_MINUS, "Remove"):
        state.requests.append(RemovePeer(peer_id=person.peer_id))
    if person.peer.identity and _item(icons.ICON_FA_BAN, "Bar until the room is empty"):
        state.barred[person.peer.identity] = person.name
        state.requests.append(BarIdentity(identity=person.peer.identity, is_barred=True))


def _barred(state: ViewState) -> None:
    """Those whom this admin has barred, each with a button that lets them rejoin."""
    for identity, name in tuple(state.barred.items()):
        widgets.note(f"{name} may not rejoin until the room is empty.")
        if widgets.action_button(f"{icons.ICON_FA_ROTATE_LEFT}  Let {name} rejoin"):
            del state.barred[identity]
            state.requests.append(BarIdentity(identity=identity, is_barred=False))


def _encryption(call: CallView) -> None:
    """How the encryption stands, with the code in groups that can be read aloud."""
    status = call.status
    if not status.is_encrypted:
        text = "Not encrypted end to end: the operator of the relay can read the faces."
        widgets.note(text)
        return
    if not status.code:
        widgets.note("Encrypted end to end. No other participant is verified yet.")
        return
    widgets.note("Encrypted end to end. All participants must read the same code:")
    groups = status.code.split()
    with widgets.type_size(CODE_PT, is_bold=True):
        for begin in range(0, len(groups), 3):
            imgui.text_unformatted("   ".join(groups[begin : begin + 3]))
    widgets.note("A different code means that the relay shows you different people.")
