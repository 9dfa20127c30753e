"""The settings of a call."""

from dataclasses import replace

from imgui_bundle import imgui

from pica_client.ui.actions import Action, Request, key_of
from pica_client.ui.call_view import CallView
from pica_client.ui.join_form import SOURCES
from pica_client.ui.panels.side import side_panel
from pica_client.ui.panels.sound import MICROPHONE, microphone_picker, sound_part
from pica_client.ui.state import LAYOUT_TITLES, MIN_DETAIL, SCALES, ViewState
from pica_client.ui.surface.theme import Metrics, Mode
from pica_client.ui.surface.widgets import action_button, choice_of, note, one_of
from pica_client.voice.sound.settings import SoundState

MODES: dict[Mode, str] = {"dark": "Dark", "light": "Light"}
MAX_NAME = 64
"""Characters of a name that are taken from its field."""


def settings_panel(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """The user's identity and sound, and how the call is shown: a tab for each that there is."""
    requests: list[Request] = []
    if state.side != "settings":
        return requests
    with side_panel("Settings", metrics, requests):
        if not imgui.begin_tab_bar("parts"):
            return requests
        if state.avatars and imgui.begin_tab_item("You")[0]:
            requests += _identity(state, call, metrics)
            imgui.end_tab_item()
        if call.sound is not None and imgui.begin_tab_item("Sound")[0]:
            requests += _sound(state, call.sound, metrics)
            imgui.end_tab_item()
        if imgui.begin_tab_item("View")[0]:
            requests += _shown(state, metrics)
            imgui.end_tab_item()
        imgui.end_tab_bar()
        if state.avatars:
            requests += _rejoining(state, call, metrics)
    return requests


def _identity(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """Face source, avatar and name; the last two hold after rejoining."""
    requests: list[Request] = []
    note("Your face", metrics)
    before = call.own.source or state.source or ""
    source = choice_of("##source", SOURCES, before)
    if source != before:
        state.source = source
    calibrate = f"Calibrate   [{key_of(Action.CALIBRATE)}]"
    if call.own.seen and action_button(calibrate, metrics):
        requests.append(Action.CALIBRATE)
    note("Your avatar", metrics)
    avatars = (("", "By your name"), *((name, name.title()) for name in state.avatars))
    state.avatar = choice_of("##avatar", avatars, state.avatar)
    note("Your name", metrics)
    imgui.set_next_item_width(-1)
    state.name = imgui.input_text("##name", state.name)[1][:MAX_NAME]
    return requests


def _rejoining(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """A button, where something was chosen that holds only after rejoining."""
    entered = state.entered
    sends = state.own_face != "none"
    shows = bool(call.own.source or state.source)
    if state.identity._replace(source=entered.source) == entered and shows == sends:
        return []
    note("You leave for a moment and join again.", metrics)
    return [Action.REJOIN] if action_button("Join again as this", metrics, tone="accent") else []


def _sound(state: ViewState, sound: SoundState, metrics: Metrics) -> list[Request]:
    """Microphone and loudspeaker; a microphone is opened or closed by rejoining."""
    note("Microphone", metrics)
    voice = state.voice or "none"
    state.voice, microphone = microphone_picker(voice, state.sound, sound)
    settings = replace(state.sound, microphone=microphone)
    is_open = state.entered.voice == MICROPHONE
    state.sound, wants_test = sound_part(settings, sound, metrics, has_microphone=is_open)
    return [Action.TEST_SOUND] if wants_test else []


def _shown(state: ViewState, metrics: Metrics) -> list[Request]:
    """How people sit, what is shown, how the surface looks, and what a picture may cost."""
    requests: list[Request] = []
    imgui.push_style_var(imgui.StyleVar_.frame_padding, (metrics.px(12), metrics.px(4)))
    note("People sit", metrics)
    if layout := one_of(LAYOUT_TITLES, state.layout, metrics):
        requests.append(state.seat(layout))
    note("Shown", metrics)
    _, state.show_statistics = imgui.checkbox("Statistics", state.show_statistics)
    if state.own_face != "none":
        _, state.shows_self = imgui.checkbox("My own face", state.shows_self)
    note("Colours", metrics)
    state.mode = one_of(MODES, state.mode, metrics) or state.mode
    note("Size of type and buttons", metrics)
    sizes = {each: f"{each:.0%}" for each in SCALES}
    state.scale = one_of(sizes, state.scale, metrics) or state.scale
    imgui.pop_style_var()
    percent, least = round(100 * state.detail), round(100 * MIN_DETAIL)
    note(f"Detail {percent} %. Less leaves more of this machine to others.", metrics)
    imgui.set_next_item_width(-1)
    has_changed, percent = imgui.slider_int("##detail", percent, least, 100, "")
    if has_changed:
        state.detail = min(max(percent, least), 100) / 100
    return requests
