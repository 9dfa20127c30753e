"""Microphone, loudspeaker and what comes through them; in the form and in a call."""

from collections.abc import Sequence
from dataclasses import replace

from imgui_bundle import imgui

from pica_client.ui.actions import TALK_KEY
from pica_client.ui.surface import icons
from pica_client.ui.surface.theme import GAP_PT, Metrics, Tone
from pica_client.ui.surface.widgets import action_button, choice_of, ink, note
from pica_client.voice.sound.settings import SoundSettings, SoundState

NO_VOICE, MICROPHONE = "none", "mic"
"""Voices, as `voice.source.open_voice` names them."""
SOFTEST_DB, LOUD_DB = 60, 4
"""What a meter begins at, and what is too loud: decibels below full scale."""
MAX_PERCENT = 200
SYSTEMS_OWN = "The system's"


def microphone_picker(voice: str, settings: SoundSettings, state: SoundState) -> tuple[str, str]:
    """Whose voice is to be sent, and by which microphone; what is another voice stays a choice."""
    chosen = f"{voice}:{settings.microphone}" if voice == MICROPHONE else voice
    devices = _devices(state.microphones, settings.microphone, f"{MICROPHONE}:")
    found = choice_of("##microphone", ((NO_VOICE, "Off: only listen"), *devices), chosen)
    kind, _, device = found.partition(":")
    return (kind, device) if kind == MICROPHONE else (found, settings.microphone)


def sound_part(
    settings: SoundSettings, state: SoundState, metrics: Metrics, *, has_microphone: bool
) -> tuple[SoundSettings, bool]:
    """Meters, loudspeaker, volume and switches; gives what is set, and whether to play a test."""
    if has_microphone:
        _meter(state.microphone_level, metrics)
        _remark(state.microphone.note, metrics)
        if state.cleaning:
            note(state.cleaning[0].upper() + state.cleaning[1:], metrics)
        else:
            _, cleans = imgui.checkbox("Take out echo and noise", settings.cleans)
            settings = replace(settings, cleans=cleans)
        _, is_held = imgui.checkbox(f"Hold {TALK_KEY} to talk", settings.push_to_talk)
        settings = replace(settings, push_to_talk=is_held)
    note("Loudspeaker", metrics)
    devices = _devices(state.speakers, settings.speaker)
    settings = replace(settings, speaker=choice_of("##speaker", devices, settings.speaker))
    _meter(state.speaker_level, metrics)
    _remark(state.speaker.note, metrics)
    settings = replace(settings, volume=volume_slider("##volume", settings.volume, metrics))
    _, is_stereo = imgui.checkbox("Voices come from their seats", settings.is_stereo)
    settings = replace(settings, is_stereo=is_stereo)
    return settings, action_button(f"{icons.SPEAKER}  Play a test sound", metrics)


def volume_slider(label: str, volume: float, metrics: Metrics, *, width_px: float = -1.0) -> float:
    """How loud something is, 0 to twice as loud as it comes."""
    percent = round(100 * volume)
    note(f"Volume {percent} %", metrics)
    imgui.set_next_item_width(width_px)
    has_changed, percent = imgui.slider_int(label, percent, 0, MAX_PERCENT, "")
    return min(max(percent, 0), MAX_PERCENT) / 100 if has_changed else volume


def _devices(names: Sequence[str], chosen: str, prefix: str = "") -> list[tuple[str, str]]:
    """Values and titles to choose from; one that is not there is said to be so."""
    found = [(prefix, SYSTEMS_OWN), *((prefix + name, name) for name in names)]
    if chosen and chosen not in names:
        found.append((prefix + chosen, f"{chosen} (not there)"))
    return found


def _meter(level: int, metrics: Metrics) -> None:
    """A bar as long as the sound is loud."""
    share = min(max((SOFTEST_DB - level) / SOFTEST_DB, 0.0), 1.0)
    tone: Tone = "warning" if level < LOUD_DB else "good"
    low, width, high = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x, 6.0
    shapes, palette, height = imgui.get_window_draw_list(), metrics.palette, metrics.px(high)
    corner, end = (low.x, low.y), (low.x + width, low.y + height)
    shapes.add_rect_filled(corner, end, ink(palette.field), height / 2)
    if share > 0:
        end = (low.x + max(share * width, height), low.y + height)
        shapes.add_rect_filled(corner, end, ink(palette.tone(tone)), height / 2)
    imgui.dummy((width, height + metrics.px(GAP_PT) / 4))


def _remark(text: str, metrics: Metrics) -> None:
    if text:
        note(text, metrics, tone="warning")
