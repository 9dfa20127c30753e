"""The commands for trackers, with a phone that sends."""

import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from helpers import tracker_packets
from pica_client.cli.track import CalibrateOptions, TrackOptions, calibrate, track
from pica_client.sources.calibration import load_calibration

pytestmark = pytest.mark.realtime

Packet = Callable[[int, float], bytes]
"""A datagram by its number and how far the jaw is open."""


@contextmanager
def playing(port: int, packet: Packet) -> Iterator[None]:
    """A phone that sends to a port of this machine, 60 times a second."""
    stopping = threading.Event()

    def play() -> None:
        frame = 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as phone:
            while not stopping.wait(1 / 60):
                frame += 1
                jaw = 0.4 + 0.4 * float(np.sin(frame / 8))
                phone.sendto(packet(frame, jaw), ("127.0.0.1", port))

    thread = threading.Thread(target=play)
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        thread.join()


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def test_track_reports_and_records_what_comes(tmp_path: Path) -> None:
    port, path = free_port(), tmp_path / "a.csv"

    def packet(frame: int, jaw: float) -> bytes:
        return tracker_packets.live_link({"JawOpen": jaw}, frame=frame)

    with playing(port, packet):
        result = track(TrackOptions(source=f"livelink:{port}", seconds=1.5, record=path))
    assert 40 < result["frames"] < 95
    assert result["shapes"]["jawOpen"]["max"] > 0.7
    assert any("the head never turns" in hint for hint in result["hints"])
    assert json.dumps(result)
    assert len(path.read_text().splitlines()) > 40


def test_calibrate_keeps_a_person_and_joining_under_that_name_uses_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    port, begin_s = free_port(), time.monotonic()

    def packet(frame: int, _: float) -> bytes:
        blink = 0.8 if time.monotonic() - begin_s > 1.2 else 0.05
        values = {"MouthSmileLeft": 0.25, "EyeBlinkLeft": blink, "EyeBlinkRight": blink}
        return tracker_packets.live_link(values, frame=frame)

    with playing(port, packet):
        options = CalibrateOptions(
            source=f"livelink:{port}", name="Ada", seconds=0.5, eyes_closed=0.5
        )
        result = calibrate(options)
    assert result["neutral"] == {"mouthSmileLeft": 0.25}
    assert result["lid_closed"] == pytest.approx([0.8, 0.8], abs=0.01)
    stored = load_calibration("Ada", "livelink")
    assert stored is not None
    assert stored.lid_open == pytest.approx((0.05, 0.05), abs=0.01)
