"""The viewer's loop, off the screen: faces in, pictures and a report out."""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui

from helpers.hand import Event, hold, point, press
from helpers.toy import make_toy_avatar
from pica_client.call.call import Reflection
from pica_client.call.status import FaceState, FaceStatus
from pica_client.publish import FaceControls, Publisher, SenderConfig
from pica_client.sources import open_source
from pica_client.ui.options import ViewOptions
from pica_client.ui.viewer import SelfView, Viewer
from pica_core.avatar.file import Avatar, load_avatar, shipped_avatar_files
from pica_core.avatar.spec import AvatarSpec
from pica_core.codec.latent_stream import LatentEncoder
from pica_core.errors import AvatarFileError
from pica_core.gl import create_context

pytestmark = pytest.mark.render

TOY = make_toy_avatar(spec=AvatarSpec(uv_encoding_size=64, axis_encoding_size=64), grid=24)
SMALL = ViewOptions(size="160x90")
PATIENCE_S = 20.0
KEY = imgui.Key


class Faces:
    """A call without a network: the test says who is there."""

    def __init__(self, *peers: str) -> None:
        self.latent = np.zeros((8, 8, 4), np.float32)
        self.present = list(peers)
        self.captured_us = 1
        self.avatars: dict[str, Avatar | None] = {"toy": TOY, "late": None}
        self.avatar_of = dict.fromkeys(peers, "toy")
        self.without_latent: set[str] = set()
        self.status: FaceStatus = "live"

    def faces(self, now: float, *_: object) -> list[FaceState]:
        return [
            FaceState(
                peer_id=peer,
                name=peer.title(),
                avatar_id=self.avatar_of[peer],
                latent=None if peer in self.without_latent else self.latent,
                captured_us=self.captured_us,
                status="waiting" if peer in self.without_latent else self.status,
                place=place,
            )
            for place, peer in enumerate(self.present)
        ]

    def avatar(self, avatar_id: str) -> Avatar | None:
        if avatar_id == "evil":
            raise AvatarFileError("evil.pica: tensor u_encoding is missing")
        return self.avatars[avatar_id]

    def subscribe(self, peer_id: str, every: int, now: float) -> None:
        """There is no stream."""


def do(viewer: Viewer, *events: Event) -> None:
    """Have the user do something before the next frame."""
    for event in events:
        event(viewer.surface.io)


def key(name: str) -> tuple[Event, Event]:
    """A key that is pressed and let go."""
    found = getattr(KEY, name)
    return press(found), press(found, is_down=False)


def click(viewer: Viewer, x: float, y: float, now: float) -> None:
    """Point at a place, press and let go, in a frame each."""
    for number, event in enumerate((point(x, y), hold(), hold(is_down=False))):
        do(viewer, event)
        viewer.step(now + 0.03 * number)


def step_until_decoded(viewer: Viewer, now: float = 1.0) -> None:
    """Draw a frame that submits, wait for the worker, draw a frame that shows."""
    viewer.step(now)
    assert viewer.wait_decoded(PATIENCE_S)
    viewer.step(now + 0.033)


@pytest.fixture
def two() -> Iterator[tuple[Faces, Viewer]]:
    source = Faces("ada", "grace")
    with Viewer(source, SMALL, clock=lambda: 5.0) as viewer:
        yield source, viewer


def test_every_peer_is_decoded_drawn_and_counted_until_they_leave(
    two: tuple[Faces, Viewer],
) -> None:
    source, viewer = two
    step_until_decoded(viewer)
    assert viewer.last_draw is not None
    assert (viewer.last_draw.num_avatars, viewer.last_draw.num_placeholders) == (2, 0)
    report = viewer.report()
    assert report["rendered_peers"] == 2
    assert report["frames_rendered"] == 2
    assert report["errors"] == 0
    assert report["decodes"] == {"ada": 1, "grace": 1}
    source.present.remove("ada")
    step_until_decoded(viewer)
    assert viewer.last_draw.num_avatars == 1
    assert viewer.report()["decodes"].keys() == {"grace"}


def test_latency_is_counted_once_per_sample_on_the_shared_clock(two: tuple[Faces, Viewer]) -> None:
    source, viewer = two
    source.captured_us = 4_990_000
    step_until_decoded(viewer)
    source.latent = source.latent + np.float32(0.5)  # interpolated on, from the same sample
    step_until_decoded(viewer)
    assert viewer.report()["latency_ms"]["p50"] == pytest.approx(10.0)
    assert viewer.report()["decodes"] == {"ada": 2, "grace": 2}


def test_a_broken_or_late_avatar_is_a_placeholder_and_the_others_go_on(
    two: tuple[Faces, Viewer],
) -> None:
    source, viewer = two
    for avatar, num_placeholders in (("evil", 1), ("late", 1), ("toy", 0)):
        source.avatar_of["ada"] = avatar
        step_until_decoded(viewer)
        assert viewer.last_draw is not None
        assert viewer.last_draw.num_placeholders == num_placeholders
        reasons = ["evil.pica: tensor u_encoding is missing"] if avatar == "evil" else []
        assert list(viewer.problems.values()) == reasons
    assert viewer.report()["errors"] == 1


def test_a_decoder_that_fails_breaks_its_own_peer(two: tuple[Faces, Viewer]) -> None:
    source, viewer = two
    step_until_decoded(viewer)
    source.latent = np.zeros((7, 8, 4), np.float32)  # no receiver does this: the session refuses it
    step_until_decoded(viewer)
    assert set(viewer.problems) == {"ada", "grace"}
    assert viewer.step(9.0)


def test_a_click_on_a_head_brings_it_forward() -> None:
    with Viewer(Faces("ada", "grace"), replace(SMALL, size="640x360")) as viewer:
        step_until_decoded(viewer)
        click(viewer, 400, 150, 2.0)
        assert viewer.state.pinned == 1


def test_a_recording_begins_and_ends_by_the_same_key_also_one_that_has_a_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    av = pytest.importorskip("av")
    kept = tmp_path / "PiCA Telepresence"
    monkeypatch.setenv("XDG_VIDEOS_DIR", str(tmp_path))
    options = replace(SMALL, record=tmp_path / "call.mp4")
    with Viewer(Faces("ada"), options, clock=lambda: 5.0) as viewer:
        is_recording = []
        for number in range(6):
            viewer.step(1.0 + 0.2 * number)
            do(viewer, *key("v"))
            for later in (0.1, 0.15):
                viewer.step(1.0 + 0.2 * number + later)
            is_recording.append(viewer.state.is_recording)
    assert is_recording == [False, True] * 3
    for path in (tmp_path / "call.mp4", *(kept / f"recording-000{n}.mp4" for n in (1, 2, 3))):
        with av.open(str(path)) as container:
            assert sum(1 for _ in container.decode(video=0)) >= 1


def test_a_camera_gets_every_image(tmp_path: Path) -> None:
    path = tmp_path / "video"
    path.touch()
    with Viewer(Faces("ada"), replace(SMALL, camera=path), clock=lambda: 5.0) as viewer:
        for now in (1.0, 1.1, 1.2):
            viewer.step(now)
        width, height = viewer.surface.io.display_size
    assert path.stat().st_size == 3 * 2 * width * height
    assert viewer.failures == []


def test_a_key_mutes_ones_own_face() -> None:
    publisher = Publisher(SenderConfig(), open_source("performance:talk"), TOY, "5" * 64)
    controls = FaceControls(publisher, "Ada", "performance:talk")
    with Viewer(Faces(), SMALL, controls=controls, clock=lambda: 5.0) as viewer:
        for now, mode in ((1.0, "muted"), (1.2, "sent")):
            do(viewer, *key("m"))
            viewer.step(now)
            viewer.step(now + 0.1)
            assert publisher.mode == mode
    controls.close()


def test_a_prepared_viewer_shows_faces_in_its_first_frame() -> None:
    with Viewer(Faces("ada", "grace"), SMALL) as viewer:
        viewer.prepare(PATIENCE_S)
        assert viewer.report()["frames_rendered"] == 0
        assert viewer.report()["decode_ms"]["p50"] is None  # nothing of it is measured

        viewer.step(1.0)

        assert viewer.last_draw is not None
        assert viewer.last_draw.num_placeholders == 0


def test_preparing_does_not_wait_for_a_broken_or_silent_peer() -> None:
    source = Faces("ada", "grace")
    source.avatar_of["ada"] = "evil"
    source.without_latent.add("grace")
    ticks = iter(range(1_000_000))

    with Viewer(source, SMALL, clock=lambda: float(next(ticks))) as viewer:
        viewer.prepare(timeout_s=1000.0)

    assert next(ticks) < 100


# The own face in the corner


AMARA = load_avatar(shipped_avatar_files()[0])


def send(reflection: Reflection, number: int) -> None:
    """Send one frame of a face that talks."""
    frame = open_source("performance:talk").frame_at(number / 30)
    coded = LatentEncoder().encode(
        frame.arkit, frame.rotation, frame.translation_m, number * 33_333
    )
    assert coded is not None
    reflection.receive(coded, number * 33_333, now=number / 30)


def test_ones_own_face_appears_once_it_is_sent_in_the_size_that_is_asked_for() -> None:
    source = open_source("performance:talk")
    track = Publisher(SenderConfig(), source, AMARA, "5" * 64).track
    reflection = Reflection(AMARA, track)
    context = create_context()
    view = SelfView(context, reflection)
    try:
        assert view.draw(0.0, 60) is None
        for number in range(30):
            send(reflection, number)
        texture, deadline_s = None, time.monotonic() + 20
        at = 1.0
        while texture is None and time.monotonic() < deadline_s:
            at += 0.1
            texture = view.draw(at, 60)
            time.sleep(0.01)
        assert texture is not None
        assert texture.size == (80, 60)
        image = np.frombuffer(texture.read(), np.uint8).reshape(60, 80, 4)
        assert image[20:40, 30:50, :3].std() > 5  # a face, and no empty room
        assert view.draw(at + 1.0, 90) is not None
        assert view.draw(at + 1.0, 90).size == (120, 90)  # type: ignore[union-attr]
    finally:
        view.close()
        context.release()
