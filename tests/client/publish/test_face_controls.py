"""What one does with one's own face while it is sent."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_client.publish import REST_S, FaceControls, Publisher, SenderConfig
from pica_client.sources import Tracker, open_source
from pica_client.sources.calibration import Calibration, load_calibration, save_calibration
from pica_client.sources.live_face import TrackerSample
from pica_client.sources.tracker import UdpTracker
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT

pytestmark = pytest.mark.unit

TALK = "performance:talk"
SQUINT, JAW = ARKIT_INDEX["eyeSquintLeft"], ARKIT_INDEX["jawOpen"]
MakeControls = Callable[[str], FaceControls]


@pytest.fixture
def make_controls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[MakeControls]:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    opened: list[FaceControls] = []

    def make(source: str) -> FaceControls:
        publisher = Publisher(SenderConfig(), open_source(source), make_toy_avatar(), "5" * 64)
        opened.append(FaceControls(publisher, "Ada", source))
        return opened[-1]

    yield make
    for controls in opened:
        controls.close()
        controls.publisher.close()


@pytest.fixture
def livelink() -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return f"livelink:127.0.0.1:{probe.getsockname()[1]}"


def notices_of(controls: FaceControls, now: float = 0.0) -> list[str]:
    """What the controls say once a command is done."""
    end_s = time.monotonic() + 10
    while not (found := controls.take_notices(now)) and time.monotonic() < end_s:
        time.sleep(0.01)
    return found


def feed(controls: FaceControls, arkit: dict[int, float], begin_s: float = 100.0) -> UdpTracker:
    """Let the tracker see one face for a second and a half."""
    source = controls.publisher.source
    assert isinstance(source, UdpTracker)
    values = np.zeros(NUM_ARKIT, np.float32)
    for index, value in arkit.items():
        values[index] = value
    for number in range(90):
        source.face.push(TrackerSample(arkit=values), begin_s + number / 60)
    return source


def test_another_source_plays_the_face_from_then_on(
    make_controls: MakeControls, livelink: str
) -> None:
    controls = make_controls(TALK)
    assert controls.preview() is None
    controls.choose(livelink)
    assert notices_of(controls) == [f"Your face comes from {livelink}"]
    assert controls.source == livelink
    assert isinstance(controls.publisher.source, Tracker)
    controls.choose(f"{livelink}/Ada")  # wants the port of the one before
    assert notices_of(controls) == [f"Your face comes from {livelink}/Ada"]
    controls.choose(TALK)
    assert notices_of(controls) == [f"Your face comes from {TALK}"]


def test_the_source_before_goes_on_when_another_cannot_be_opened(
    make_controls: MakeControls, livelink: str
) -> None:
    controls = make_controls(livelink)
    controls.choose("csv:/nowhere.csv")
    (notice,) = notices_of(controls)
    assert "/nowhere.csv" in notice
    assert controls.source == livelink
    assert isinstance(controls.publisher.source, Tracker)


def test_calibrating_takes_the_resting_face_away_and_keeps_it_for_the_next_call(
    make_controls: MakeControls, livelink: str
) -> None:
    save_calibration("Ada", "livelink", Calibration(gain=1.5, lid_closed=(0.8, 0.9)))
    controls = make_controls(livelink)
    feed(controls, {JAW: 0.9})  # before it was asked for
    controls.calibrate(200.0)
    assert controls.take_notices(200.0) == ["Look ahead, relaxed, with open eyes …"]
    source = feed(controls, {SQUINT: 0.2}, begin_s=200.0)
    assert controls.take_notices(200.0 + 0.9 * REST_S) == []
    assert controls.take_notices(200.0 + REST_S) == ["Calibrated for Ada and livelink"]
    kept = load_calibration("Ada", "livelink")
    assert kept == source.face.calibration
    assert kept.neutral[SQUINT] == pytest.approx(0.2)
    assert (kept.neutral[JAW], kept.gain, kept.lid_closed) == (0.0, 1.5, (0.8, 0.9))


def test_what_cannot_be_calibrated_is_said(make_controls: MakeControls, livelink: str) -> None:
    controls = make_controls(TALK)
    controls.calibrate(0.0)
    assert "Only a tracker" in controls.take_notices(0.0)[0]
    unseen = make_controls(livelink)
    unseen.calibrate(0.0)
    assert "no face was seen" in unseen.take_notices(REST_S)[1]


def test_the_tracker_of_a_muted_face_is_still_to_be_looked_at(
    make_controls: MakeControls, livelink: str
) -> None:
    controls = make_controls(livelink)
    feed(controls, {JAW: 0.5})
    controls.publisher.seen = controls.publisher.source.frame_at(0.0)
    seen = controls.preview()
    assert seen is not None
    assert seen.picture is None
