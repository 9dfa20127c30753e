import numpy as np
import pytest

from helpers.spoken import SpokenDecoder, hum, packet, usual_arrival_s
from pica_client.voice.mixer import FARTHER_SAMPLES, VoiceMixer, limit
from pica_client.voice.opus import FRAME_SAMPLES, SAMPLE_RATE_HZ
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit


def heard(mixer: VoiceMixer, peers: list[str], seconds: float = 1.0) -> FloatArray:
    """What a mixer makes of peers who hum all the time."""
    sounds = []
    for index in range(round(seconds / 0.02)):
        now = usual_arrival_s(index)
        for peer_id in peers:
            mixer.receive(peer_id, packet(index), now)
        sounds.append(mixer.mix(now + 0.001))
    return np.concatenate(sounds)[SAMPLE_RATE_HZ // 2 :]


def mixer_of(sound: FloatArray) -> VoiceMixer:
    return VoiceMixer(lambda: SpokenDecoder(sound))


def test_the_farther_ear_hears_later_and_softer():
    mixer = mixer_of(np.random.default_rng(0).standard_normal(3 * SAMPLE_RATE_HZ) / 10)
    mixer.seat({"ann": -np.pi / 4})
    left, right = heard(mixer, ["ann"])[:FRAME_SAMPLES].T
    lags = np.correlate(right, left, "full")
    assert int(np.argmax(lags)) - (FRAME_SAMPLES - 1) == round(FARTHER_SAMPLES * np.sqrt(0.5))
    assert np.std(right) == pytest.approx(0.65 * np.std(left), rel=0.05)


def test_a_voice_that_moves_makes_no_click():
    sound = hum(3)
    mixer = mixer_of(sound)
    sounds = []
    for index in range(100):
        mixer.receive("ann", packet(index), usual_arrival_s(index))
        mixer.seat({"ann": 1.2 * (index >= 50)})
        sounds.append(mixer.mix(usual_arrival_s(index) + 0.001))
    steps = np.abs(np.diff(np.concatenate(sounds[30:]), axis=0))
    assert steps.max() < 1.5 * np.abs(np.diff(sound)).max()


def test_a_volume_of_nothing_mutes_one_person_alone():
    mixer = mixer_of(hum(3))
    mixer.set_volumes({"ann": 0.0})
    assert np.std(heard(mixer, ["ann"])) == 0
    assert np.std(heard(mixer, ["ann", "ben"])) > 0.05


def test_many_loud_voices_are_bent_and_never_cut():
    loud = 3 * np.sin(np.linspace(0, 50, 5000))
    bent = limit(loud)
    assert np.abs(bent).max() < 1
    assert np.abs(np.diff(bent)).max() <= np.abs(np.diff(loud)).max()
    quiet = np.linspace(-0.7, 0.7, 100)
    assert (limit(quiet) == quiet).all()


def test_who_left_is_forgotten():
    mixer = mixer_of(hum(1))
    for index in range(3):
        mixer.receive(f"peer{index}", packet(0), 0.1)
    mixer.seat({"peer1": 0.0})
    mixer.mix(0.2)
    assert set(mixer.voices()) == {"peer1"}


def test_the_mix_is_handed_on_as_it_leaves_the_loudspeaker():
    mixer, frames = mixer_of(hum(1)), []
    mixer.on_mixed = lambda sound, leaves_s: frames.append((sound, leaves_s))
    sound = mixer.mix(1.0, 0.05)
    assert frames[0][0] is sound
    assert frames[0][1] == pytest.approx(1.05)


def test_an_echo_of_what_is_played_is_taken_out_of_the_microphone():
    pytest.importorskip("livekit", reason="extra echo")
    from pica_client.voice.sound.worker import EchoCanceller
    from pica_client.voice.source import shipped_speech

    speech = shipped_speech()[: 4 * SAMPLE_RATE_HZ]
    echo = np.zeros_like(speech)
    echo[2880:] = 0.5 * speech[:-2880]
    canceller = EchoCanceller()
    left = []
    for played, heard_back in zip(
        speech.reshape(-1, FRAME_SAMPLES), echo.reshape(-1, FRAME_SAMPLES), strict=True
    ):
        canceller.play(np.repeat(played[:, None], 2, axis=1), 0.06)
        left.append(canceller.clean(heard_back))
    half = len(echo) // 2
    assert np.std(np.concatenate(left)[half:]) < 0.05 * np.std(echo[half:])
