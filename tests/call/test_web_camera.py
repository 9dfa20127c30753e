"""A page whose camera films a rendered head: who else is in the call sees it move."""

import io
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image

from helpers.chromium import Tab, chromium
from helpers.face_networks import face_file
from helpers.page import node_module
from helpers.paths import ROOT
from helpers.senders import LoadedAvatars
from pica_client.call.call import ArrivedFace, Call
from pica_client.decode.decoder import OnnxDecoder
from pica_client.endpoint import Receiver
from pica_client.local_call.processes import Children
from pica_client.render.renderer import Renderer
from pica_client.render.scene import Placement, view_direction
from pica_client.render.seats import plan_seats
from pica_client.render.views import ViewState, orbit_limits, plan_camera
from pica_client.transport.connect import LinkConfig
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import avatar_id, load_avatar, shipped_avatar_files
from pica_core.gl import create_context
from pica_core.types import FloatArray

pytestmark = pytest.mark.realtime

PATH = next(path for path in shipped_avatar_files() if path.stem == "henrik")
PERIOD_S, NUM_PICTURES, SIZE = 8.0, 120, (640, 480)
FILMED = """
navigator.mediaDevices.getUserMedia = new Proxy(navigator.mediaDevices.getUserMedia, {
  apply: async (...call) => (window.filmed = await Reflect.apply(...call)),
});
window.requestAnimationFrame = () => {};
"""
"""Keeps the camera for the test, and draws nothing: software takes most of two cores for it."""
MUTE = "Object.defineProperty(filmed.getTracks()[0], 'muted', {configurable: true, value: true})"


def _face(jaw: float) -> FloatArray:
    arkit = np.zeros(NUM_ARKIT, np.float32)
    arkit[ARKIT_INDEX["jawOpen"]] = jaw
    return arkit


def _jaw_at(time_s: float) -> float:
    return max(float(-np.sin(2 * np.pi * time_s / PERIOD_S)), 0.0)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A head whose mouth is open in the second half of the time: the first one is its rest."""
    path = tmp_path_factory.mktemp("film") / "head.mjpeg"
    avatar = load_avatar(PATH)
    encoder, decoder = ExpressionEncoder(avatar), OnnxDecoder(avatar)
    plan = plan_seats("grid", 1, SIZE[0] / SIZE[1])
    limits = orbit_limits(plan, (avatar.manifest.view_span,))
    camera = plan_camera(plan, ViewState(), *SIZE, limits)
    towards = view_direction(plan.seats[0], camera.centre_m)
    context = create_context()
    with Renderer(context, SIZE) as renderer, path.open("wb") as file:
        renderer.add_avatar("0", avatar)
        for number in range(NUM_PICTURES):
            latent = encoder.encode(_face(_jaw_at(number / NUM_PICTURES * PERIOD_S)))
            maps = decoder.decode(latent, towards, 256, "both")
            renderer.update_maps("0", maps.position_map, maps.expression_map)
            renderer.draw([Placement(slot="0", world_from_head=plan.seats[0])], camera)
            picture = io.BytesIO()
            Image.fromarray(renderer.read_image()).save(picture, "JPEG", quality=92)
            file.write(2 * picture.getvalue())  # it is shown at 30 a second
    context.release()
    return path


@pytest.fixture(scope="module")
def tab(film: Path) -> Iterator[Tab]:
    with chromium(f"--use-file-for-fake-video-capture={film}") as page:
        page.send("Page.addScriptToEvaluateOnNewDocument", source=FILMED)
        yield page


def _start(children: Children, folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A relay whose operator has files in this folder."""
    monkeypatch.setenv("XDG_DATA_HOME", str(folder))
    return children.start_relay()[1]


def _give_networks(folder: Path) -> None:
    models = folder / "pica-telepresence" / "models"
    models.mkdir(parents=True)
    shutil.copy(face_file(), models / "face_landmarker.task")


def _join(tab: Tab, relay: str) -> None:
    tab.open(f"{relay.replace('ws://', 'http://')}/r")
    tab.until(f"document.querySelector('[value=\"{avatar_id(PATH)}\"]') !== null")
    tab.value(f"avatar.value = '{avatar_id(PATH)}'; document.getElementById('name').value = 'Web'")
    tab.value("begin.click()")
    tab.until("camera.hidden === false", 40)


def _line(tab: Tab, text: str) -> None:
    tab.until(f"notice.textContent.includes({text!r})", 60)


def test_a_camera_moves_the_face_that_others_see(
    tab: Tab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _give_networks(tmp_path)
    identity, avatar = avatar_id(PATH), load_avatar(PATH)
    encode = ExpressionEncoder(avatar).encode
    closed, opened = encode(_face(0.0)).ravel(), encode(_face(1.0)).ravel()
    way = (opened - closed) / np.sum((opened - closed) ** 2)
    faces: list[ArrivedFace] = []
    call = Call(LoadedAvatars({identity: avatar}), on_face=faces.append)
    with Children() as children:
        relay = _start(children, tmp_path, monkeypatch)
        with Receiver(LinkConfig(url=relay, room="r", name="Ada"), call):
            _join(tab, relay)
            tab.value("camera.click()")
            _line(tab, "relaxed face")
            tab.until("!notice.textContent", 60)

            def follows() -> float:
                """How far the mouth that is seen here is that of the film, which began at any
                time."""
                faces.clear()
                time.sleep(1.5 * PERIOD_S)
                seen = faces.copy()
                jaw = np.array([(face.sample.latent.ravel() - closed) @ way for face in seen])
                assert np.ptp(jaw) > 0.5
                times_s = np.array([face.captured_us / 1e6 for face in seen])
                delays_s = np.arange(0, PERIOD_S, 0.1)
                films = [[_jaw_at(each - late) for each in times_s] for late in delays_s]
                return float(max(np.corrcoef(jaw, film)[0, 1] for film in films))

            assert follows() > 0.9  # 0.997 with nine images a second
            with tab.in_background():
                assert follows() > 0.9
            # As a phone does in the background.
            tab.value(MUTE)
            _line(tab, "no face in front of the camera")
            tab.value("delete filmed.getTracks()[0].muted")
            tab.until("!notice.textContent", 60)
            tab.value("filmed.getTracks()[0].dispatchEvent(new Event('ended'))")
            _line(tab, "the camera is gone: your voice moves your mouth")
            faces.clear()
            time.sleep(2)
            assert len(faces) > 5  # the head sways on
            assert (faces[-1].sample.latent.ravel() - closed) @ way < 0.2
            for name, line in (
                ("NotAllowedError", "the browser was not allowed to use the camera"),
                ("NotFoundError", "there is no camera"),
            ):
                tab.value(
                    "navigator.mediaDevices.getUserMedia = async () => {"
                    f"throw new DOMException('', '{name}')}}; camera.click()"
                )
                _line(tab, f"{line}: your voice moves your mouth")
            # A picture has nowhere to go.
            hosts = {each.split("/", 3)[2] for each in tab.requests if each != "about:blank"}
            assert hosts == {relay.removeprefix("ws://")}
            assert tab.complaints == []
            tab.value("leave.click()")


def test_a_whole_call_asks_for_nothing_but_its_relay(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    headset = node_module("iwer/build/iwer.min.js").read_text()
    headset += (ROOT / "tests" / "web" / "pages" / "emulate.js").read_text()
    _give_networks(tmp_path)
    with chromium(f"--use-file-for-fake-video-capture={film}") as tab, Children() as children:
        tab.note_workers()
        tab.send("Page.addScriptToEvaluateOnNewDocument", source=headset)
        relay = _start(children, tmp_path, monkeypatch)
        children.start("sender", "send", "--url", relay, "--room", "r", "--name", "Ada", "--wait")
        _join(tab, relay)
        tab.until("document.querySelector('#labels button:not(.faceless)') !== null", 60)
        tab.value("camera.click(); mute.click()")
        tab.until("mute.textContent === 'Mute'", 30)
        tab.until("camera.ariaPressed === 'true'", 30)
        tab.until("!notice.textContent", 60)
        tab.value("document.getElementById('headset').click()")
        tab.until("!!headset.activeSession", 30)
        time.sleep(3)
        asked = [each for each in tab.requests if each != "about:blank"]
        assert {each.split("/", 3)[2] for each in asked} == {relay.removeprefix("ws://")}
        files = {each.rpartition("/")[2] for each in asked}
        assert {"finder.js", "networks.js", "pulse.js", "worklet.js", "xr.js"} <= files
        assert tab.complaints == []  # the policy's report, too


def test_a_relay_without_networks_is_one_line(
    tab: Tab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Children() as children:
        _join(tab, _start(children, tmp_path, monkeypatch))
        tab.value("camera.click()")
        _line(tab, "this relay has no face networks (pica webcam setup): your voice moves")
        assert tab.value("window.filmed ?? null") is None
        tab.value("leave.click()")


def test_an_avatar_file_of_ones_own_is_given_and_worn(
    tab: Tab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = bytearray(PATH.read_bytes())
    data[-1] ^= 1  # of the last tensor: another file
    own, cut = tmp_path / "own.pica", tmp_path / "cut.pica"
    own.write_bytes(data)
    cut.write_bytes(data[:5000])
    with Children() as children:
        relay = _start(children, tmp_path, monkeypatch).replace("ws://", "http://")
        tab.open(f"{relay}/r")
        tab.until("document.getElementById('join')?.hidden === false")
        tab.value("document.getElementById('name').value = 'Web'")
        _choose(tab, cut)
        tab.until("problem.textContent.startsWith('cut.pica: this is no avatar file')")
        _choose(tab, own)
        tab.until("camera.hidden === false", 40)
        assert httpx.get(f"{relay}/avatars/{avatar_id(own)}", trust_env=False).content == data
        tab.value("leave.click()")


def _choose(tab: Tab, path: Path) -> None:
    root = tab.send("DOM.getDocument")["root"]["nodeId"]
    node = tab.send("DOM.querySelector", nodeId=root, selector="#file")["nodeId"]
    tab.send("DOM.setFileInputFiles", files=[str(path)], nodeId=node)
    tab.value("begin.click()")
