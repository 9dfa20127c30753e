"""A page in a headless Chromium in calls with Python's senders, through a real relay."""

import json
import os
import signal
import time
import wave
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
import pytest

from helpers.chromium import Tab, chromium
from helpers.senders import LoadedAvatars
from pica_client.call.call import Call, Ears
from pica_client.e2ee.secret import RoomSecret, save_secret
from pica_client.endpoint import Receiver
from pica_client.local_call.processes import Child, Children
from pica_client.transport.connect import LinkConfig
from pica_client.voice import opus
from pica_core.avatar.file import avatar_id, load_avatar, shipped_avatar_files
from pica_core.types import FloatArray
from pica_protocol.frames import Frame
from pica_server.tokens import Admission, load_keys, mint, new_key_line

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(opus.available() is not None, reason="needs libopus"),
]

JOIN = """
(async () => {
  const folder = document.querySelector("script").src.replace("main.js", "");
  const {Call} = await import(`${folder}call.js`);
  window.pica = new Call(new URL(".", location.href));
  const fragment = new URLSearchParams(location.hash.slice(1));
  const secret = fragment.get("secret") ?? "";
  const [room, token] = [location.pathname.slice(1), fragment.get("token") ?? ""];
  const avatarId = fragment.get("avatar") ?? "";
  pica.join({room, token, secret, name: fragment.get("name") ?? "Web", avatarId});
})()
"""
"""As the page joins, but that nothing is drawn: software takes most of two cores for it."""
FACES = (
    "pica.participants.filter((each) => each.faceAt(performance.now() / 1000)?.status === 'live')"
)
HEARD = (
    "pica.participants.filter("
    "(each) => pica.voice.heardUs(each.id, performance.now() / 1000) !== null)"
)
RECORD = """
(async () => {
  const {context, limiter} = pica.voice;
  const tap = new AnalyserNode(context, {fftSize: 32768});
  limiter.connect(tap);
  await new Promise((done) => setTimeout(done, 1000));
  const sound = new Float32Array(32768);
  tap.getFloatTimeDomainData(sound);
  return Array.from(sound);
})()
"""
RATE_HZ = 48_000
LIKE_ENOUGH = 0.8
"""Correlation of the waveforms: Opus keeps the sound rather than its phases (measured: 0.8)."""


def _voice(path: Path) -> FloatArray:
    """Write ten seconds of a voice of sorts: harmonics of a gliding pitch, in syllables."""
    time_s = np.arange(10 * RATE_HZ) / RATE_HZ
    rng = np.random.default_rng(1)
    pitch_hz = np.interp(time_s, np.arange(0, 10, 0.2), rng.uniform(110, 220, 50))
    phase = 2 * np.pi * np.cumsum(pitch_hz) / RATE_HZ
    sound = sum(np.sin(n * phase) / n for n in range(1, 12))
    sound *= 0.1 * (0.6 + 0.4 * np.sin(2 * np.pi * 4 * time_s))
    with wave.open(str(path), "wb") as file:
        file.setparams((1, 2, RATE_HZ, 0, "NONE", ""))
        file.writeframes((sound * 32767).astype("<i2").tobytes())
    return sound.astype(np.float32)


def _likeness(heard: FloatArray, said: FloatArray) -> float:
    """The largest correlation of what was heard with any part of what was said, over and over."""
    size = len(said)
    spectrum = np.fft.rfft(said) * np.conj(np.fft.rfft(heard, size))
    products = np.fft.irfft(spectrum, size)
    energy = np.concatenate([[0.0], np.tile(said, 2) ** 2]).cumsum()[: size + len(heard)]
    norms = np.sqrt(energy[len(heard) :] - energy[:size]) * np.linalg.norm(heard)

    return float((products / np.maximum(norms, 1e-9)).max())


@pytest.fixture
def children() -> Iterator[Children]:
    with Children() as group:
        yield group


@pytest.fixture(scope="module")
def tab() -> Iterator[Tab]:
    with chromium() as page:
        yield page


def _send(children: Children, url: str, name: str, room: str, *more: str) -> Child:
    options = ("--url", url, "--room", room, "--name", name, "--wait", *more)
    return children.start(f"sender-{name}", "send", *options)


def _enter(tab: Tab, relay: str, room: str, state: str = "joined", **fragment: str) -> None:
    tab.open("about:blank")  # a change of what follows the # alone loads nothing
    tab.open(f"{relay.replace('ws://', 'http://')}/{room}#{urlencode(fragment)}")
    tab.until("document.getElementById('join')?.hidden === false")
    tab.value(JOIN)
    tab.until(f"window.pica?.status.state === {json.dumps(state)}")


def test_three_people_are_seen_and_heard_and_come_back_with_the_relay(
    children: Children, tab: Tab, tmp_path: Path
) -> None:
    relay, url = children.start_relay()
    said = _voice(tmp_path / "voice.wav")
    _send(children, url, "Ada", "r", "--voice", str(tmp_path / "voice.wav"))
    _send(children, url, "Ben", "r")
    _send(children, url, "Cyd", "r")
    _enter(tab, url, "r")
    tab.until(f"{FACES}.length === 3", 30)
    tab.until(f"{HEARD}.length > 0")
    tries = [_likeness(np.array(tab.value(RECORD)), said)]
    while tries[-1] < LIKE_ENOUGH and len(tries) < 6:  # a busy machine tears a voice now and then
        tries.append(_likeness(np.array(tab.value(RECORD)), said))
    assert tries[-1] >= LIKE_ENOUGH, tries
    assert tab.value("pica.participants.map((each) => each.name).sort()") == ["Ada", "Ben", "Cyd"]
    host = url.removeprefix("ws://")
    asked = [each for each in tab.requests if each != "about:blank"]
    assert {each.partition("://")[2].partition("/")[0] for each in asked} == {host}
    assert tab.complaints == []

    os.kill(relay.pid, signal.SIGKILL)
    tab.until("pica.status.state === 'reconnecting'")
    children.start("relay-2", "relay", "--port", url.rpartition(":")[2])
    tab.until(f"pica.status.state === 'joined' && {FACES}.length === 3", 30)


def test_the_page_draws_who_is_in_the_room(children: Children, tab: Tab) -> None:
    _, url = children.start_relay()
    _send(children, url, "Ada", "r")
    tab.open("about:blank")
    tab.complaints.clear()  # of a relay that was killed
    tab.open(url.replace("ws://", "http://") + "/r")
    tab.until("document.getElementById('join')?.hidden === false")
    tab.value("document.getElementById('name').value = 'Web'")
    tab.value("document.getElementById('join').requestSubmit()")
    tab.until("document.getElementById('labels').textContent.includes('Ada')", 60)
    assert tab.complaints == []


class _Listener(Ears):
    """Counts packets of voices."""

    num_packets = 0

    def receive(self, peer_id: str, packet: Frame, arrived_s: float) -> None:
        self.num_packets += 1


def test_a_voice_and_the_face_that_it_moves_arrive(children: Children, tab: Tab) -> None:
    _, url = children.start_relay()
    path = shipped_avatar_files()[0]
    identity, avatar = avatar_id(path), load_avatar(path)
    ears, latents = _Listener(), []
    call = Call(
        LoadedAvatars({identity: avatar}),
        ears=ears,
        on_face=lambda face: latents.append(face.sample.latent),
    )
    with Receiver(LinkConfig(url=url, room="r", name="Ada"), call):
        _enter(tab, url, "r", avatar=identity)
        tab.until("pica.self?.faceAt(performance.now() / 1000)", 30)
        tab.value("pica.voice.speak()")  # of the browser's own device, which beeps
        ends_s = time.monotonic() + 60
        while ears.num_packets < 10 or len(latents) < 40:
            assert time.monotonic() < ends_s, (ears.num_packets, len(latents))
            time.sleep(0.1)
        assert call.num_live == 1
        assert call.errors == 0
    assert np.std(np.array(latents), axis=0).max() > 0.1
    assert tab.complaints == []


def test_what_is_wrong_with_a_link_is_one_clear_line(
    children: Children, tab: Tab, tmp_path: Path
) -> None:
    keys = tmp_path / "keys"
    keys.write_text(new_key_line())
    _, url = children.start_relay("--keys", str(keys))

    def token(room: str, since_s: float) -> str:
        guest = Admission(identity="guest", may_publish=True)
        return mint(load_keys(keys), room, guest, now=time.time() - since_s, lasts_s=60)

    for fragment, reason in (
        ({}, "this relay wants a token"),
        ({"token": token("r", 3600)}, "the token has expired"),
        ({"token": token("elsewhere", 0)}, "the token is for another room"),
        ({"token": token("r", 0), "name": "\N{FULLWIDTH LATIN CAPITAL LETTER W}" * 64}, "64 bytes"),
        ({"token": token("r", 0), "secret": "hunter2"}, "the link's secret is no room secret"),
    ):
        _enter(tab, url, "r", "ended", **fragment)
        assert reason in tab.value("pica.status.reason")


def test_an_encrypted_face_is_seen_with_its_secret_alone(
    children: Children, tab: Tab, tmp_path: Path
) -> None:
    _, url = children.start_relay()
    save_secret(tmp_path / "secret", RoomSecret.new())
    save_secret(tmp_path / "other", RoomSecret.new())
    secret, other = [(tmp_path / each).read_text().strip()[14:] for each in ("secret", "other")]
    _send(children, url, "Eve", "s", "--secret-file", str(tmp_path / "secret"))
    for given, seal in ((secret, "verified"), (other, "secret differs"), ("", "")):
        _enter(tab, url, "s", secret=given)
        if seal:
            tab.until(f"pica.participants[0]?.seal === {json.dumps(seal)}")
        else:
            tab.until("pica.participants[0]?.state.startsWith('encrypted')")
        if seal == "verified":
            tab.until(f"{FACES}.length === 1", 20)
            assert len(tab.value("pica.status.code")) == 35
        else:
            assert tab.value(f"{FACES}.length") == 0
        tab.value("pica.leave()")
