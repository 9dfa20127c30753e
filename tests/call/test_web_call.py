"""A page in a headless Chromium in calls with Python's senders, through a real relay."""

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
import pytest

from helpers.chromium import Tab, chromium
from helpers.proxies import folder_proxy, moving_relay
from helpers.senders import LoadedAvatars
from helpers.stoi import stoi
from pica_client.call.call import Call, Ears
from pica_client.e2ee.secret import RoomSecret, save_secret
from pica_client.endpoint import Receiver
from pica_client.local_call.processes import Child, Children
from pica_client.transport.connect import LinkConfig
from pica_client.voice import opus
from pica_client.voice.source import shipped_speech
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
  const tap = new AudioWorkletNode(context, "pica-microphone", {numberOfOutputs: 0});
  limiter.connect(tap);
  const sound = [];
  tap.port.onmessage = ({data}) => sound.push(...data.pcm);
  await new Promise((done) => setTimeout(done, 2500));
  limiter.disconnect(tap);
  return sound.map((value) => Math.round(value * 32767));
})()
"""
UNDERSTOOD = 0.9
"""Of STOI; Opus and the jitter buffer alone give 0.95 to 0.99."""


def _understood(heard: FloatArray, said: FloatArray) -> float:
    """STOI of what was heard of a sound that is said over and over."""
    size = len(said)
    spectrum = np.fft.rfft(said) * np.conj(np.fft.rfft(heard, size))
    begin = int(np.fft.irfft(spectrum, size).argmax())
    return stoi(np.take(said, np.arange(begin, begin + len(heard)), mode="wrap"), heard)


@pytest.fixture
def children() -> Iterator[Children]:
    with Children() as group:
        yield group


@pytest.fixture(scope="module")
def tab() -> Iterator[Tab]:
    with chromium() as page:
        yield page


@pytest.fixture(scope="module")
def shy() -> Iterator[Tab]:
    """A browser in which sound waits for a tap."""
    with chromium("--autoplay-policy=document-user-activation-required") as page:
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
    children: Children, tab: Tab
) -> None:
    relay, url = children.start_relay()
    _send(children, url, "Ada", "r", "--voice", "speech")
    _send(children, url, "Ben", "r")
    _send(children, url, "Cyd", "r")
    _enter(tab, url, "r")
    tab.until(f"{FACES}.length === 3", 30)
    tab.until(f"{HEARD}.length > 0")
    tries: list[float] = []
    while not tries or (tries[-1] < UNDERSTOOD and len(tries) < 6):  # a busy machine tears voices
        heard = np.array(tab.value(RECORD)).astype(np.float32) / 32767
        tries.append(_understood(heard, shipped_speech()))
    assert tries[-1] >= UNDERSTOOD, tries
    assert tab.value("pica.participants.map((each) => each.name).sort()") == ["Ada", "Ben", "Cyd"]
    host = url.removeprefix("ws://")
    asked = [each for each in tab.requests if each != "about:blank"]
    assert {each.partition("://")[2].partition("/")[0] for each in asked} == {host}
    assert tab.complaints == []

    os.kill(relay.pid, signal.SIGKILL)
    tab.until("pica.status.state === 'reconnecting'")
    children.start("relay-2", "relay", "--port", url.rpartition(":")[2])
    tab.until(f"pica.status.state === 'joined' && {FACES}.length === 3", 30)


def test_two_pages_and_a_sender_see_each_other(children: Children, tab: Tab, shy: Tab) -> None:
    _, url = children.start_relay()
    _send(children, url, "Ada", "r")
    for page, name, path in zip((tab, shy), ("Web", "Net"), shipped_avatar_files(), strict=False):
        _enter(page, url, "r", name=name, avatar=avatar_id(path))
    for page, others in ((tab, ["Ada", "Net"]), (shy, ["Ada", "Web"])):
        page.until(f"{FACES}.length === 2", 40)
        assert page.value("pica.participants.map((each) => each.name).sort()") == others
        assert page.complaints == []


def test_a_page_in_a_folder_of_a_proxy_draws_who_is_there_and_wants_a_tap_to_sound(
    children: Children, shy: Tab
) -> None:
    _, url = children.start_relay()
    _send(children, url, "Ada", "r")
    with folder_proxy("/calls", int(url.rpartition(":")[2])) as port:
        shy.open("about:blank")
        shy.open(f"http://127.0.0.1:{port}/calls/r")
        shy.until("document.getElementById('join')?.hidden === false")
        shy.value("document.getElementById('name').value = 'Web'")
        shy.value("document.getElementById('join').requestSubmit()")
        shy.until("document.getElementById('labels').textContent.includes('Ada')", 60)
        shown = shy.until("(({hidden, textContent}) => !hidden && textContent)(hear)")
        assert shown == "Tap to hear"
        shy.tap("hear")
        shy.until("hear.hidden")
        asked = {each.split("/", 3)[2] for each in shy.requests if each != "about:blank"}
        assert asked == {f"127.0.0.1:{port}"}
        assert all("AudioContext was not allowed" in each for each in shy.complaints)
        shy.value("leave.click()")


def test_a_relay_that_sends_the_page_elsewhere_is_one_line(tab: Tab) -> None:
    with moving_relay("ws://elsewhere.example") as url:
        _enter(tab, url, "r", "joining")
        line = "the room is at another relay, ws://elsewhere.example: open the link there"
        tab.until(f"pica.status.reason === {json.dumps(line)}", 30)


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
        with tab.in_background():  # where a page has slow timers and draws nothing
            time.sleep(1)
            began, ears.num_packets = len(latents), 0
            time.sleep(4)
            assert len(latents) - began > 60  # 120 on a calm machine
            assert ears.num_packets > 40
            assert np.std(np.array(latents[began:]), axis=0).max() > 0.1
            assert tab.value("pica.self.playout.timeline.frames.length") <= 64 + 9
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
