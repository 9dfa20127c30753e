"""What one does with one's own face while it is sent."""

import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from helpers.toy import make_toy_avatar
from pica_client.publish import FaceControls, Publisher, SenderConfig
from pica_client.sources import Tracker, open_source

pytestmark = pytest.mark.unit

TALK = "performance:talk"
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
        return f"livelink:{probe.getsockname()[1]}"


def notice_of(controls: FaceControls) -> str:
    """What the controls say once a command is done."""
    end_s = time.monotonic() + 10
    while not (found := controls.take_notice()) and time.monotonic() < end_s:
        time.sleep(0.01)
    return found


def test_another_source_plays_the_face_from_then_on(
    make_controls: MakeControls, livelink: str
) -> None:
    controls = make_controls(TALK)
    assert controls.preview() is None
    controls.choose(livelink)
    assert notice_of(controls) == f"Your face comes from {livelink}"
    assert controls.source == livelink
    assert isinstance(controls.publisher.source, Tracker)
    other = livelink.replace("livelink", "vmc")  # wants the port of the one before
    for source in (other, TALK):
        controls.choose(source)
        assert notice_of(controls) == f"Your face comes from {source}"


def test_the_source_before_goes_on_when_another_cannot_be_opened(
    make_controls: MakeControls, livelink: str
) -> None:
    controls = make_controls(livelink)
    controls.choose("csv:/nowhere.csv")
    assert "/nowhere.csv" in notice_of(controls)
    assert controls.source == livelink
    assert isinstance(controls.publisher.source, Tracker)


def test_the_tracker_of_a_muted_face_is_still_to_be_looked_at(
    make_controls: MakeControls, livelink: str
) -> None:
    controls = make_controls(livelink)
    controls.publisher.seen = controls.publisher.source.frame_at(0.0)
    assert controls.preview() == (False, None)
