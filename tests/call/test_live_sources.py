"""Trackers of every kind in one call, through the real relay, and the commands for them."""

import asyncio
import json
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from helpers import tracker_packets
from helpers.senders import LoadedAvatars
from helpers.toy import make_toy_avatar
from pica_client.call.call import Call
from pica_client.cli.track import CalibrateOptions, TrackOptions, calibrate, track
from pica_client.endpoint import Receiver, Sender
from pica_client.publish import Outgoing, Publisher, SenderConfig
from pica_client.sources.calibration import load_calibration
from pica_client.sources.registry import open_live
from pica_client.sources.tracker import UdpTracker
from pica_client.transport.connect import LinkConfig
from pica_server.config import RelayConfig
from pica_server.relay import Relay

pytestmark = pytest.mark.realtime

AVATAR_ID = "6" * 64
AVATAR = make_toy_avatar()
Packet = Callable[[int, float], bytes]
"""A datagram by its number and how far the jaw is open."""

PACKETS: dict[str, Packet] = {
    "livelink": lambda frame, jaw: tracker_packets.live_link({"JawOpen": jaw}, frame=frame),
    "vmc": lambda frame, jaw: tracker_packets.vmc({"JawOpen": jaw}, seconds=frame / 60),
    "ifacialmocap": lambda _, jaw: tracker_packets.ifacialmocap({"jawOpen": round(jaw * 100)}),
    "facemotion3d": lambda _, jaw: tracker_packets.ifacialmocap(
        {"jawOpen": round(jaw * 100)}, separator="&"
    ),
}


def listen(kind: str) -> UdpTracker:
    """A tracker of that kind at a free port; phones are not asked, they send at once."""
    if kind in ("livelink", "vmc"):
        return open_live(kind, "0")
    return UdpTracker(kind, 0)


@contextmanager
def playing(*targets: tuple[int, Packet]) -> Iterator[None]:
    """Phones that send to ports of this machine, 60 times a second."""
    stopping = threading.Event()

    def play() -> None:
        frame = 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as phone:
            while not stopping.wait(1 / 60):
                frame += 1
                for port, packet in targets:
                    jaw = 0.4 + 0.4 * float(np.sin(frame / 8))
                    phone.sendto(packet(frame, jaw), ("127.0.0.1", port))

    thread = threading.Thread(target=play)
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        thread.join()


@pytest.mark.asyncio
async def test_trackers_of_every_kind_are_in_one_call() -> None:
    faces = Counter[str]()
    sources = {kind: listen(kind) for kind in PACKETS}
    port = sources["livelink"].port
    avatars = LoadedAvatars({AVATAR_ID: AVATAR})
    call = Call(avatars, on_face=lambda face: faces.update([face.name]))
    with playing(*((sources[kind].port, packet) for kind, packet in PACKETS.items())):
        async with Relay(RelayConfig(port=0)) as relay:
            receiver = Receiver(LinkConfig(url=relay.url, name="me"), call)
            receiving = asyncio.create_task(receiver.run())
            config, senders = SenderConfig(seconds=2.0), []
            for kind, source in sources.items():
                face = Publisher(config, source, AVATAR, AVATAR_ID)
                link = LinkConfig(url=relay.url, name=kind)
                senders.append(Sender(link, Outgoing(face=face)))
            await asyncio.gather(*(sender.run() for sender in senders))
            delays = {kind: source.face.delay_s for kind, source in sources.items()}
            receiver.stop()
            await receiving
            assert all(sender.stats()["sent"] > 20 for sender in senders)
    open_live("livelink", f"{port}").close()  # a sender that ends frees its port
    assert min(faces[kind] for kind in PACKETS) > 20
    assert max(delays.values()) <= 0.08


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def test_track_reports_and_records_what_comes(tmp_path: Path) -> None:
    port, path = free_port(), tmp_path / "a.csv"
    with playing((port, PACKETS["livelink"])):
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

    with playing((port, packet)):
        options = CalibrateOptions(
            source=f"livelink:{port}", name="Ada", seconds=0.5, eyes_closed=0.5
        )
        result = calibrate(options)
    assert result["neutral"] == {"mouthSmileLeft": 0.25}
    assert result["lid_closed"] == pytest.approx([0.8, 0.8], abs=0.01)
    stored = load_calibration("Ada", "livelink")
    assert stored is not None
    assert stored.lid_open == pytest.approx((0.05, 0.05), abs=0.01)
