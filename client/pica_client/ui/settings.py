"""The settings of a call; the microphone is also chosen in the form that begins one."""

from collections.abc import Sequence
from dataclasses import replace

from imgui_bundle import imgui

from pica_client.sources.source import PERFORMANCES
from pica_client.ui.actions import TALK_KEY
from pica_client.ui.call_view import CallView
from pica_client.ui.state import LAYOUT_TITLES, SCALES, ViewState
from pica_client.ui.widgets import TONES, Tone, choice_of, note, px
from pica_client.voice.sound.settings import DeviceState, SoundState

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
