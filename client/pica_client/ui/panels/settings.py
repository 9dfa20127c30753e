"""The settings of a call."""

from dataclasses import replace

from imgui_bundle import imgui

from pica_client.ui.call_view import CallView
from pica_client.ui.controls import KEYS_OF, LAYOUT_TITLES, ChooseLayout, Order, UserOrder
from pica_client.ui.joining.form import SOURCES
from pica_client.ui.panels.side import side_panel
from pica_client.ui.panels.sound import MICROPHONE, microphone_picker, sound_part
from pica_client.ui.settings import MIN_DETAIL, SCALES, Settings
from pica_client.ui.surface.theme import Metrics
from pica_client.ui.surface.widgets import action_button, choice_of, note
from pica_client.voice.sound.settings import SoundState

MAX_NAME = 64
"""Characters of a name that are taken from its field."""


def settings_panel(view: CallView, metrics: Metrics) -> list[UserOrder]:
    """How people sit, what is shown, how the surface looks, and what a picture may cost."""
    orders: list[UserOrder] = []
    state = view.state
    if state.side != "settings":
        return orders
    settings = state.settings
    with side_panel("Settings", metrics, orders):
        if view.avatars:
            orders += _own(view, metrics)
            imgui.separator()
        if view.sound is not None:
            orders += _sound(view, view.sound, metrics)
            imgui.separator()
        note("People sit", metrics)
        for number, (layout, title) in enumerate(LAYOUT_TITLES.items()):
            if number % 2:
                imgui.same_line(metrics.px(130))
            if imgui.radio_button(title, layout == state.layout):
                orders.append(ChooseLayout(layout))
        imgui.separator()
        note("Shown", metrics)
        has_changed, _ = imgui.checkbox("Statistics", state.show_statistics)
        if has_changed:
            orders.append(Order.STATISTICS)
        if state.own_face != "none":
            _, shows_self = imgui.checkbox("My own face", settings.shows_self)
            settings = replace(settings, shows_self=shows_self)
        imgui.separator()
        settings = _look(settings, metrics)
        imgui.separator()
        note("Detail. Less leaves more of this machine to others.", metrics)
        imgui.set_next_item_width(-1)
        percent = round(100 * settings.detail)
        has_changed, percent = imgui.slider_int(
            "##detail", percent, round(100 * MIN_DETAIL), 100, "%d %%"
        )
        if has_changed:
            least = 100 * MIN_DETAIL
            settings = replace(settings, detail=min(max(percent, least), 100) / 100)
    if settings != state.settings:
        orders.append(settings)
    return orders


def _own(view: CallView, metrics: Metrics) -> list[UserOrder]:
    """Face source, avatar and name; the last two hold once one has come in again."""
    orders: list[UserOrder] = []
    wanted, sends = view.state.choice, view.state.own_face != "none"
    chosen = replace(wanted, source=view.own.source or wanted.source)
    note("Your face", metrics)
    source = choice_of("##source", SOURCES, chosen.source)
    if view.own.has_tracker and action_button(f"Calibrate   [{KEYS_OF[Order.CALIBRATE]}]", metrics):
        orders.append(Order.CALIBRATE)
    note("Your avatar", metrics)
    avatars = (("", "By your name"), *((name, name.title()) for name in view.avatars))
    avatar = choice_of("##avatar", avatars, chosen.avatar)
    note("Your name", metrics)
    imgui.set_next_item_width(-1)
    _, name = imgui.input_text("##name", chosen.name)
    found = replace(chosen, source=source, avatar=avatar, name=name[:MAX_NAME])
    if found != chosen:
        orders.append(found)
    entered, comes = view.entered_as, bool(found.source)
    has_other_voice = wanted.voice != entered.voice
    if has_other_voice or (found.name, found.avatar, comes) != (
        entered.name,
        entered.avatar,
        sends,
    ):
        note("You leave for a moment and come again.", metrics)
        if action_button("Come again as this", metrics, tone="accent"):
            orders.append(Order.REJOIN)
    return orders


def _sound(view: CallView, state: SoundState, metrics: Metrics) -> list[UserOrder]:
    """Microphone and loudspeaker; who sends no voice, or no more, comes in again for it."""
    orders: list[UserOrder] = []
    settings, wanted = view.state.sound, view.state.choice
    note("Microphone", metrics)
    voice, microphone = microphone_picker(wanted.voice, settings, state)
    if voice != wanted.voice:
        orders.append(replace(wanted, voice=voice))
    settings = replace(settings, microphone=microphone)
    is_open = view.entered_as.voice == MICROPHONE
    settings, wants_test = sound_part(settings, state, metrics, has_microphone=is_open)
    if settings != view.state.sound:
        orders.append(settings)
    if wants_test:
        orders.append(Order.TEST_SOUND)
    return orders


def _look(settings: Settings, metrics: Metrics) -> Settings:
    note("Colours", metrics)
    for number, mode in enumerate(("dark", "light")):
        if number:
            imgui.same_line(metrics.px(130))
        if imgui.radio_button(mode.title(), mode == settings.mode):
            settings = replace(settings, mode=mode)  # type: ignore[arg-type]
    note("Size of type and buttons", metrics)
    for number, scale in enumerate(SCALES):
        if number % 2:
            imgui.same_line(metrics.px(130))
        if imgui.radio_button(f"{scale:.0%}", scale == settings.scale):
            settings = replace(settings, scale=scale)
    return settings
