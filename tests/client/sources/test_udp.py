"""Live sources on real sockets of this machine, and recordings of what they sent."""

import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers import tracker_packets
from pica_client.cli.track import Recorder
from pica_client.errors import SourceError
from pica_client.sources import open_source
from pica_client.sources.calibration import calibrate, load_calibration, save_calibration
from pica_client.sources.live_face import TrackerSample
from pica_client.sources.registry import open_live
from pica_client.sources.tracker import SampleTap, UdpTracker
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT

pytestmark = pytest.mark.unit

JAW = ARKIT_INDEX["jawOpen"]


@pytest.fixture
def phone() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        own.settimeout(5)
        yield own


def until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 10
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def stream(phone: socket.socket, tracker: UdpTracker, jaw: float) -> None:
    """Send samples until the face shows the jaw."""
    frame = 0

    def shows() -> bool:
        nonlocal frame
        frame += 1
        packet = tracker_packets.live_link({"JawOpen": jaw}, frame=frame)
        phone.sendto(packet, ("127.0.0.1", tracker.port))
        time.sleep(1 / 60)
        face = tracker.frame_at(time.monotonic())
        return face.has_face and abs(float(face.arkit[JAW]) - jaw) < 0.02

    until(shows)


def noting(jaws: list[float]) -> SampleTap:
    """A tap that notes how far the jaw is open."""
    return lambda sample, arrived_s: jaws.append(float(sample.arkit[JAW]))


def test_a_phone_is_asked_and_others_are_not_heard(phone: socket.socket) -> None:
    jaws: list[float] = []
    with (
        closing(UdpTracker("ifacialmocap", 0, None, noting(jaws), phone="127.0.0.1")) as tracker,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        other.bind(("127.0.0.2", 0))
        for each, jaw in ((other, 90), (phone, 60)):
            packet = tracker_packets.ifacialmocap({"jawOpen": jaw})
            each.sendto(packet, ("127.0.0.1", tracker.port))
        until(lambda: bool(jaws))
        assert jaws == pytest.approx([0.6])


def test_a_port_that_is_taken_is_said_with_the_way_out() -> None:
    with closing(open_live("livelink", "0")) as first:
        port = first.port
        with pytest.raises(SourceError, match=rf"UDP port {port}: .*livelink:PORT"):
            open_live("livelink", f"{port}")


def test_a_phone_on_this_machine_is_listened_to_at_no_other_address() -> None:
    datagrams = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with closing(open_live("facemotion3d", "127.0.0.1")) as tracker, datagrams as other:
        other.bind(("127.0.0.2", tracker.port))  # taken, if every address were listened to


def test_a_silent_tracker_says_where_it_must_send_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pica_client.sources.tracker.SILENT_S", 0.0)
    for place, words in (("0", "use vmc:lan"), ("lan:0", "must send to")):
        with closing(open_live("vmc", place)) as tracker:
            assert f"port {tracker.port}" in tracker.trouble
            assert words in tracker.trouble


def test_the_first_address_is_the_tracker_until_it_is_silent(phone: socket.socket) -> None:
    jaws: list[float] = []
    with (
        closing(open_live("livelink", "0", tap=noting(jaws))) as tracker,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        other.bind(("127.0.0.2", 0))
        stream(phone, tracker, 0.5)
        packet = tracker_packets.live_link({"JawOpen": 1.0}, frame=9_999)
        other.sendto(packet, ("127.0.0.1", tracker.port))
        until(lambda: bool(tracker.refused))
        assert tracker.sender == "127.0.0.1"
        assert max(jaws) == pytest.approx(0.5)


def test_a_tracker_in_the_wrong_mode_is_told_so(
    phone: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    with closing(open_live("livelink", "0")) as tracker:
        phone.sendto(bytes(584), ("127.0.0.1", tracker.port))
        until(lambda: bool(tracker.refused))
        monkeypatch.setattr("pica_client.sources.tracker.SILENT_S", 0.0)
        assert "switch it to Live Link (ARKit)" in tracker.trouble


def samples() -> list[tuple[float, TrackerSample]]:
    made = []
    for index in range(90):
        arkit = np.full(NUM_ARKIT, np.nan, np.float32)
        arkit[JAW] = 0.5 + 0.5 * np.sin(index / 10)
        sample = TrackerSample(tracker_s=index / 30, arkit=arkit, has_face=index < 80)
        made.append((100 + index / 30, sample))
    return made


def test_a_recording_plays_what_came(tmp_path: Path) -> None:
    path, recorder, turn = tmp_path / "face.csv", Recorder(), np.float32([0.1, -0.4, 0.2])
    for arrived_s, sample in samples():
        recorder(replace(sample, rotation=turn), arrived_s)
    recorder.save(path)

    recording = open_source(f"csv:{path}")

    for index in (0, 31, 79):
        face = recording.frame_at(index / 30)
        assert face.has_face
        assert face.arkit[JAW] == pytest.approx(0.5 + 0.5 * np.sin(index / 10), abs=1e-3)
        assert face.arkit.sum() == face.arkit[JAW]  # what was not sent is at rest
        np.testing.assert_allclose(face.rotation, turn, atol=1e-5)
    assert not recording.frame_at(85 / 30).has_face


def test_a_report_counts_what_came_and_says_what_would_mend_it() -> None:
    report = Recorder()
    for arrived_s, sample in samples():
        report(sample, arrived_s)
    result = report.report("livelink", "", Counter())
    assert result["frames"] == 90
    assert result["fps"] == pytest.approx(30, abs=0.1)
    assert result["gap_ms"]["p50"] == pytest.approx(1000 / 30, abs=0.1)
    assert result["frames_without_face"] == 10
    assert result["no_face_ratio"] == pytest.approx(10 / 90, abs=1e-3)
    assert list(result["shapes"]) == ["jawOpen"]
    hints = " ".join(result["hints"])
    assert "often sees no face" in hints
    assert "not sent" in hints
    assert "Stream Head Rotation" in hints


def test_a_calibration_is_made_kept_and_found_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    rest = np.zeros(NUM_ARKIT, np.float32)
    rest[ARKIT_INDEX["mouthSmileLeft"]] = 0.2
    closed = rest.copy()
    closed[[ARKIT_INDEX["eyeBlinkLeft"], ARKIT_INDEX["eyeBlinkRight"]]] = 0.7
    made = calibrate([rest] * 5, [closed] * 5)
    path = save_calibration("Ada B.", "livelink", made)
    assert load_calibration("Ada B.", "livelink") == made
    assert load_calibration("Ada B.", "vmc") is None
    assert path.stat().st_mode & 0o077 == 0
    assert made.lid_closed == pytest.approx((0.7, 0.7))
    path.write_text('{"neutral": [0.5]}')
    with pytest.raises(SourceError, match="pica calibrate livelink"):
        load_calibration("Ada B.", "livelink")


def test_shapes_that_a_tracker_does_not_send_have_no_neutral() -> None:
    arkit = np.full(NUM_ARKIT, np.nan, np.float32)
    arkit[ARKIT_INDEX["mouthSmileLeft"]] = 0.2
    calibration = calibrate([arkit, arkit], [])
    assert calibration.neutral[ARKIT_INDEX["mouthSmileLeft"]] == pytest.approx(0.2)
    assert calibration.neutral[ARKIT_INDEX["cheekPuff"]] == 0
    with pytest.raises(SourceError, match="did not close"):
        calibrate([arkit], [arkit])
