"""What one does with one's own face while it is sent."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_client.publish.face_desk import REST_S, FaceDesk
from pica_client.publish.publisher import Publisher, SenderConfig
from pica_client.sources import Tracker, open_source
from pica_client.sources.live.calibration import Calibration, CalibrationStore
from pica_client.sources.live.live_face import TrackerSample
from pica_client.sources.live.tracker import UdpTracker
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT

pytestmark = pytest.mark.unit

TALK = "performance:talk"
SQUINT, JAW = ARKIT_INDEX["eyeSquintLeft"], ARKIT_INDEX["jawOpen"]
Desks = Callable[[str], FaceDesk]


@pytest.fixture
def store(tmp_path: Path) -> CalibrationStore:
    return CalibrationStore(tmp_path / "calibrations")


@pytest.fixture
def desk_for(store: CalibrationStore) -> Iterator[Desks]:
    opened: list[FaceDesk] = []

    def make(source: str) -> FaceDesk:
        publisher = Publisher(SenderConfig(), open_source(source), make_toy_avatar(), "5" * 64)
        opened.append(FaceDesk(publisher, "Ada", source, store))
        return opened[-1]

    yield make
    for desk in opened:
        desk.close()
        desk.publisher.close()


@pytest.fixture
def livelink() -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return f"livelink:127.0.0.1:{probe.getsockname()[1]}"


def notices_of(desk: FaceDesk, now: float = 0.0) -> list[str]:
    """What the desk says once what was ordered is done."""
    end_s = time.monotonic() + 10
    while not (found := desk.take_notices(now)) and time.monotonic() < end_s:
        time.sleep(0.01)
    return found


def feed(desk: FaceDesk, arkit: dict[int, float], count: int = 60) -> None:
    source = desk.publisher.source
    assert isinstance(source, UdpTracker)
    values = np.zeros(NUM_ARKIT, np.float32)
    for index, value in arkit.items():
        values[index] = value
    for number in range(count):
        source.face.push(TrackerSample(arkit=values), 100.0 + number / 60)


def test_another_source_plays_the_face_from_then_on(desk_for: Desks, livelink: str) -> None:
    desk = desk_for(TALK)
    assert desk.seen() is None
    desk.choose(livelink)
    assert notices_of(desk) == [f"Your face comes from {livelink}"]
    assert desk.source == livelink
    assert isinstance(desk.publisher.source, Tracker)
    desk.choose(f"{livelink}/Ada")  # wants the port of the one before
    assert notices_of(desk) == [f"Your face comes from {livelink}/Ada"]
    desk.choose(TALK)
    assert notices_of(desk) == [f"Your face comes from {TALK}"]


def test_the_source_before_goes_on_when_another_cannot_be_opened(
    desk_for: Desks, livelink: str
) -> None:
    desk = desk_for(livelink)
    desk.choose("csv:/nowhere.csv")
    (notice,) = notices_of(desk)
    assert "/nowhere.csv" in notice
    assert desk.source == livelink
    assert isinstance(desk.publisher.source, Tracker)


def test_calibrating_takes_the_resting_face_away_and_keeps_it_for_the_next_call(
    desk_for: Desks, store: CalibrationStore, livelink: str
) -> None:
    store.save("Ada", "livelink", Calibration(gain=1.5, lid_closed=(0.8, 0.9)))
    desk = desk_for(livelink)
    feed(desk, {JAW: 0.9})  # before it was asked for
    desk.calibrate(200.0)
    assert desk.take_notices(200.0) == ["Look ahead, relaxed, with open eyes …"]
    feed(desk, {}, count=0)
    source = desk.publisher.source
    assert isinstance(source, UdpTracker)
    squint = np.zeros(NUM_ARKIT, np.float32)
    squint[SQUINT] = 0.2
    for number in range(90):
        source.face.push(TrackerSample(arkit=squint), 200.0 + number / 60)
    assert desk.take_notices(200.0 + 0.9 * REST_S) == []
    assert desk.take_notices(200.0 + REST_S) == ["Calibrated for Ada and livelink"]
    kept = store.load("Ada", "livelink")
    assert kept == source.face.calibration
    assert kept.neutral[SQUINT] == pytest.approx(0.2)
    assert (kept.neutral[JAW], kept.gain, kept.lid_closed) == (0.0, 1.5, (0.8, 0.9))


def test_what_cannot_be_calibrated_is_said(desk_for: Desks, livelink: str) -> None:
    desk = desk_for(TALK)
    desk.calibrate(0.0)
    assert "Only a tracker" in desk.take_notices(0.0)[0]
    unseen = desk_for(livelink)
    unseen.calibrate(0.0)
    assert "no face was seen" in unseen.take_notices(REST_S)[1]


def test_the_tracker_of_a_muted_face_is_still_to_be_looked_at(
    desk_for: Desks, livelink: str
) -> None:
    desk = desk_for(livelink)
    feed(desk, {JAW: 0.5})
    desk.publisher.seen = desk.publisher.source.frame_at(0.0)
    seen = desk.seen()
    assert seen is not None
    assert dict(seen.bars)["Smile"] == 0.0
    assert seen.picture is None
