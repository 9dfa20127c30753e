"""How long a tracker's sample takes from our socket to the relay's, for each protocol.

python scripts/live_latency.py --seconds 30       --record keeps the figures

The phone is a process that sends a talking face 60 times a second over loopback; the relay is
another. What is measured is the sender itself, with its own threads, sockets and clock:

    take_ms     datagram at our socket -> smoothed sample, ready to be shown
    send_ms     the frame is due -> its bytes are with the system's socket
    path_ms     both together, of the newest sample that the frame is made of
    wait_ms     what that sample waited in between: for the sample after the moment that is shown,
                and for the next frame to be due. The price of even motion at the stream's rate
    delay_ms    how much later than it was seen a face is shown, as the live face states it

Smoothing is not in it. How late it makes a movement of 2 Hz comes beside, as the shift that fits
best, for large and small movements.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import socket
import subprocess
import sys
import time
from bisect import bisect_right
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "scripts")]

from record_result import append_result, load_now  # noqa: E402

from helpers import tracker_packets  # noqa: E402
from pica_client.avatars.library import AvatarLibrary  # noqa: E402
from pica_client.local_call.processes import Children  # noqa: E402
from pica_client.publish.sender import Sender, SenderConfig  # noqa: E402
from pica_client.sources import open_source  # noqa: E402
from pica_client.sources.live.opening import LIVE_KINDS, decoder_of  # noqa: E402
from pica_client.sources.live.sample import TrackerSample  # noqa: E402
from pica_client.sources.live.smoothing import Smoother  # noqa: E402
from pica_client.sources.live.udp import UdpOptions, UdpTracker  # noqa: E402
from pica_client.transport.config import LinkConfig  # noqa: E402
from pica_client.transport.connect import RelayWebsocket, open_websocket  # noqa: E402
from pica_core.avatar.arkit import (  # noqa: E402
    ARKIT_INDEX,
    ARKIT_NAMES,
    NUM_ARKIT,
    ExpressionFrame,
)

TRACKER_FPS = 60
WARM_UP_S = 2.0


def play_phone(kind: str, port: int, seconds: float) -> None:
    """Send a talking face to a port of this machine."""
    source, begin_s = open_source("performance:talk"), time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as phone:
        for frame in range(round(seconds * TRACKER_FPS)):
            arkit = source.frame_at(frame / TRACKER_FPS).arkit.tolist()
            packet = tracker_packets.packet_of(
                kind, dict(zip(ARKIT_NAMES, arkit, strict=True)), frame, TRACKER_FPS
            )
            time.sleep(max(begin_s + frame / TRACKER_FPS - time.monotonic(), 0.0))
            phone.sendto(packet, ("127.0.0.1", port))


class Times:
    """Gathers the times of one sender; source and websocket report to it."""

    def __init__(self) -> None:
        self.arrived_s: list[float] = []
        self.took_s: list[float] = []
        self.frames: list[tuple[float, float, float, float]] = []
        self._asked: tuple[float, float, float] | None = None

    def tap(self, sample: TrackerSample, arrived_s: float, process_s: float) -> None:
        """A sample is ready."""
        self.took_s.append(process_s)
        self.arrived_s.append(arrived_s)

    def watch(self, tracker: UdpTracker) -> None:
        """Note when a face is asked for, and the newest sample at that time."""
        show = tracker.frame_at

        def frame_at(time_s: float) -> ExpressionFrame:
            now, frame = time.monotonic(), show(time_s)
            newest = bisect_right(self.arrived_s, now) - 1
            if frame.has_face and newest >= 0:
                self._asked = now, self.arrived_s[newest], self.took_s[newest]
            return frame

        tracker.frame_at = frame_at  # type: ignore[method-assign]

    async def connect(self, url: str) -> RelayWebsocket:
        """A websocket that notes when what it was given is with the system."""
        websocket = await open_websocket(url)
        send = websocket.send

        async def timed(message: Any, *rest: Any) -> None:
            await send(message, *rest)
            if self._asked is not None:
                self.frames.append((*self._asked, time.monotonic()))
                self._asked = None

        websocket.send = timed  # type: ignore[method-assign, assignment]
        return websocket


def measure(kind: str, seconds: float, url: str, library: AvatarLibrary) -> dict[str, Any]:
    """One protocol's figures."""
    times = Times()
    tracker = UdpTracker(UdpOptions(kind, 0, host="127.0.0.1"), decoder_of(kind), tap=times.tap)
    times.watch(tracker)
    total_s = seconds + WARM_UP_S
    arguments = ["--phone", kind, "--port", str(tracker.port), "--seconds", f"{total_s + 2}"]
    phone = subprocess.Popen([sys.executable, __file__, *arguments])
    name = library.names[0]
    sender = Sender(
        SenderConfig(seconds=total_s),
        LinkConfig(url=url, name=kind),
        tracker,
        library.load(library.find(name)),
        library.find(name),
        connector=times.connect,
    )
    try:
        stats = asyncio.run(sender.run())
    finally:
        phone.terminate()
        phone.wait()
    kept = np.array(times.frames[round(WARM_UP_S * 30) :])
    due_s, arrived_s, took_s, sent_s = kept.T
    return {
        "protocol": kind,
        "samples": len(times.took_s),
        "frames": len(kept),
        "take_ms": _ms(times.took_s),
        "send_ms": _ms(sent_s - due_s),
        "path_ms": _ms(took_s + sent_s - due_s),
        "wait_ms": _ms(np.maximum(due_s - arrived_s - took_s, 0)),
        "delay_ms": round(tracker.face.delay_s * 1e3, 1),
        "skipped": stats["skipped"],
    }


MOVEMENTS = (
    ("lids", ARKIT_INDEX["eyeBlinkLeft"], (0.8, 0.2)),
    ("mouth", ARKIT_INDEX["jawOpen"], (0.8, 0.2)),
    ("brows", ARKIT_INDEX["browInnerUp"], (0.8, 0.2)),
    ("head, radians", NUM_ARKIT, (0.3, 0.1)),
    ("head, metres", NUM_ARKIT + 3, (0.1, 0.02)),
)
"""What moves, where it stands among the filter's values, and by how much."""


def smoothing_rows(hertz: float = 2.0) -> list[dict[str, Any]]:
    """How late smoothing makes movements, by what moves."""
    times_s = np.arange(8 * TRACKER_FPS) / TRACKER_FPS
    shifts_s = np.arange(0, 0.1, 0.0005)
    rows = []
    for name, place, sizes in MOVEMENTS:
        found = []
        for size in sizes:
            smoother, seen = Smoother(), []
            for value in 0.5 * size * (1 - np.cos(2 * np.pi * hertz * times_s)):
                values = np.zeros(NUM_ARKIT + 6, np.float32)
                values[place] = value
                arkit, head, offset_m = np.split(values, [NUM_ARKIT, NUM_ARKIT + 3])
                smoothed = smoother.smooth(arkit, head, offset_m, 1 / TRACKER_FPS)
                seen.append(np.concatenate(smoothed)[place])
            settled = np.array(seen[TRACKER_FPS:]) - np.mean(seen[TRACKER_FPS:])
            shifted = times_s[None, TRACKER_FPS:] - shifts_s[:, None]
            apart = np.abs(settled + 0.5 * size * np.cos(2 * np.pi * hertz * shifted)).mean(1)
            found.append(round(float(shifts_s[apart.argmin()]) * 1e3, 1))
        large, small = (f"{size:g}" for size in sizes)
        rows.append({"movement": name, "sizes": f"{large} / {small}", "delay_ms": found})
    return rows


def _ms(values_s: Any) -> dict[str, float]:
    values_ms = np.asarray(values_s) * 1e3
    return {
        name: round(float(np.percentile(values_ms, at)), 2)
        for name, at in (("p50", 50), ("p99", 99), ("max", 100))
    }


def main() -> None:
    """Read the command line, measure each protocol in turn."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0, help="measured, each protocol")
    parser.add_argument("--record", action="store_true", help="append to docs/results/live.jsonl")
    parser.add_argument("--phone", help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.phone:
        play_phone(options.phone, options.port, options.seconds)
        return
    library, load = AvatarLibrary(), load_now()
    with Children() as children:
        _, url = children.start_relay()
        rows = [measure(kind, options.seconds, url, library) for kind in LIVE_KINDS]
    library.close()
    result = {"rows": rows, "smoothing": smoothing_rows()}
    print(json.dumps(result))
    if options.record:
        command = " ".join(["scripts/live_latency.py", *sys.argv[1:]])
        append_result("live", command, result, load)


if __name__ == "__main__":
    main()
