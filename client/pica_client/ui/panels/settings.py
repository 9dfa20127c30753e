"""The settings of a call."""

from dataclasses import replace

from imgui_bundle import imgui

from pica_client.ui.call_view import CallView
from pica_client.ui.controls import (
    KEYS_OF,
    LAYOUT_TITLES,
    ChooseLayout,
    ControlState,
    Order,
    UserOrder,
)
from pica_client.ui.joining.form import SOURCES
from pica_client.ui.panels.side import side_panel
from pica_client.ui.panels.sound import MICROPHONE, microphone_picker, sound_part
from pica_client.ui.settings import MIN_DETAIL, SCALES, Mode
from pica_client.ui.surface.theme import Metrics
from pica_client.ui.surface.widgets import action_button, choice_of, note, one_of
from pica_client.voice.sound.settings import SoundState

MODES: dict[Mode, str] = {"dark": "Dark", "light": "Light"}
MAX_NAME = 64
"""Characters of a name that are taken from its field."""


def settings_panel(view: CallView, metrics: Metrics) -> list[UserOrder]:
    """Who one is, one's sound, and how the call is shown: a tab for each that there is."""
    orders: list[UserOrder] = []
    if view.state.side != "settings":
        return orders
    with side_panel("Settings", metrics, orders):
        if not imgui.begin_tab_bar("parts"):
            return orders
        if view.state.avatars and imgui.begin_tab_item("You")[0]:
            orders += _own(view, metrics)
            imgui.end_tab_item()
        if view.sound is not None and imgui.begin_tab_item("Sound")[0]:
            orders += _sound(view, view.sound, metrics)
            imgui.end_tab_item()
        if imgui.begin_tab_item("View")[0]:
            orders += _shown(view.state, metrics)
            imgui.end_tab_item()
        imgui.end_tab_bar()
        if view.state.avatars:
            orders += _coming_again(view, metrics)
    return orders


def _own(view: CallView, metrics: Metrics) -> list[UserOrder]:
    """Face source, avatar and name; the last two hold once one has come in again."""
    orders: list[UserOrder] = []
    wanted = view.state.choice
    chosen = replace(wanted, source=view.own.source or wanted.source)
    note("Your face", metrics)
    source = choice_of("##source", SOURCES, chosen.source)
    if view.own.seen and action_button(f"Calibrate   [{KEYS_OF[Order.CALIBRATE]}]", metrics):
        orders.append(Order.CALIBRATE)
    note("Your avatar", metrics)
    avatars = (("", "By your name"), *((name, name.title()) for name in view.state.avatars))
    avatar = choice_of("##avatar", avatars, chosen.avatar)
    note("Your name", metrics)
    imgui.set_next_item_width(-1)
    _, name = imgui.input_text("##name", chosen.name)
    found = replace(chosen, source=source, avatar=avatar, name=name[:MAX_NAME])
    if found != chosen:
        orders.append(found)
    return orders


def _coming_again(view: CallView, metrics: Metrics) -> list[UserOrder]:
    """A button, where something was chosen that holds only once one has come in again."""
    entered, wanted = view.state.entered_as, view.state.choice
    sends = view.state.own_face != "none"
    shows = bool(view.own.source or wanted.source)
    if replace(wanted, source=entered.source) == entered and shows == sends:
        return []
    note("You leave for a moment and come again.", metrics)
    return [Order.REJOIN] if action_button("Come again as this", metrics, tone="accent") else []


def _sound(view: CallView, state: SoundState, metrics: Metrics) -> list[UserOrder]:
    """Microphone and loudspeaker; who sends no voice, or no more, comes in again for it."""
    orders: list[UserOrder] = []
    settings, wanted = view.state.sound, view.state.choice
    note("Microphone", metrics)
    voice, microphone = microphone_picker(wanted.voice, settings, state)
    if voice != wanted.voice:
        orders.append(replace(wanted, voice=voice))
    settings = replace(settings, microphone=microphone)
    is_open = view.state.entered_as.voice == MICROPHONE
    settings, wants_test = sound_part(settings, state, metrics, has_microphone=is_open)
    if settings != view.state.sound:
        orders.append(settings)
    if wants_test:
        orders.append(Order.TEST_SOUND)
    return orders


def _shown(state: ControlState, metrics: Metrics) -> list[UserOrder]:
    """How people sit, what is shown, how the surface looks, and what a picture may cost."""
    orders: list[UserOrder] = []
    settings = state.settings
    imgui.push_style_var(imgui.StyleVar_.frame_padding, (metrics.px(12), metrics.px(4)))
    note("People sit", metrics)
    if layout := one_of(LAYOUT_TITLES, state.layout, metrics):
        orders.append(ChooseLayout(layout))
    note("Shown", metrics)
    has_changed, _ = imgui.checkbox("Statistics", state.show_statistics)
    if has_changed:
        orders.append(Order.STATISTICS)
    if state.own_face != "none":
        _, shows_self = imgui.checkbox("My own face", settings.shows_self)
        settings = replace(settings, shows_self=shows_self)
    note("Colours", metrics)
    mode = one_of(MODES, settings.mode, metrics) or settings.mode
    note("Size of type and buttons", metrics)
    scale = one_of({each: f"{each:.0%}" for each in SCALES}, settings.scale, metrics)
    settings = replace(settings, mode=mode, scale=scale or settings.scale)
    imgui.pop_style_var()
    percent, least = round(100 * settings.detail), round(100 * MIN_DETAIL)
    note(f"Detail {percent} %. Less leaves more of this machine to others.", metrics)
    imgui.set_next_item_width(-1)
    has_changed, percent = imgui.slider_int("##detail", percent, least, 100, "")
    if has_changed:
        settings = replace(settings, detail=min(max(percent, least), 100) / 100)
    if settings != state.settings:
        orders.append(settings)
    return orders
