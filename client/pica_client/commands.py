"""The commands of the client: thin functions from options to the parts that do the work.

What needs the `view` extra is imported inside its command, so that a sender runs without it.
"""

from __future__ import annotations

import asyncio
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pica_client.avatars import AvatarLibrary
from pica_client.link import LinkConfig
from pica_client.playout import PlayoutConfig
from pica_client.sender import Sender, SenderConfig
from pica_client.signals import on_stop_signal
from pica_client.sources import open_source
from pica_client.staging import StageConfig, choose_avatars

CONNECT_TIMEOUT_S = 3.0
"""How long a command tries to reach a relay before it gives up, unless told to wait."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SendOptions:
    """Options of ``pica send``."""

    url: str = "ws://127.0.0.1:8765"
    """Address of the relay, ws:// or wss://."""
    room: str = "lobby"
    """Room to join: letters, digits and _ . -"""
    name: str = "guest"
    """Name the others see."""
    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; the first shipped one by default."""
    source: str = "performance:talk"
    """csv:FILE[@SECONDS] plays a Live Link Face recording, performance:NAME[#SEED][@SECONDS] one
    that ships: talk, listen or range_of_motion."""
    fps: float = 30.0
    """Frames a second, 1 to 240."""
    seconds: float = 0.0
    """How long to send; 0 is until Ctrl-C."""
    wait: bool = False
    """Wait for a relay that is not there yet instead of giving up after 3 seconds."""
    frame_log: Path | None = None
    """Write capture and encoding time of each frame, in microseconds, into this file at the end."""


def send(options: SendOptions) -> dict[str, Any]:
    """Send one face to a room: read expressions, encode them, stream the latents.

    Runs until Ctrl-C or for --seconds, and comes back by itself when the relay goes away and
    returns.
    """
    config = SenderConfig(fps=options.fps, seconds=options.seconds)
    link = LinkConfig(
        url=options.url,
        room=options.room,
        name=options.name,
        connect_timeout_s=None if options.wait else CONNECT_TIMEOUT_S,
    )
    source = open_source(options.source)
    library = AvatarLibrary()
    try:
        (chosen, *_) = choose_avatars(options.avatar, library)
        identity = library.find(chosen)
        avatar = library.load(identity)
    finally:
        library.close()

    async def run() -> tuple[dict[str, Any], list[tuple[int, int]]]:
        sender = Sender(config, link, source, avatar, identity)
        loop = asyncio.get_running_loop()
        with on_stop_signal(lambda: loop.call_soon_threadsafe(sender.stop)):
            return await sender.run(), list(sender.frame_log)

    _say(f"sending {options.source} as {options.name} to room {options.room} at {options.url}")
    result, frame_log = asyncio.run(run())
    if options.frame_log is not None:
        options.frame_log.write_text(json.dumps(frame_log))
    _say(f"sent {result['sent']} frames, {result['payload_bps'] or 0} bit/s of payload")
    return result


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchCallOptions:
    """Options of ``pica bench call``."""

    peers: int = 5
    """Number of senders, each a process."""
    seconds: float = 20.0
    """Measured time, seconds."""
    source: str | None = None
    """What all senders play, each starting elsewhere in it; by default shipped performances."""
    avatar: str | None = None
    """Names or .pica files of avatars, separated by commas, dealt in turn."""
    fps: float = 30.0
    """Frames a second of each sender."""
    playout_floor_ms: float = field(default=PlayoutConfig().floor_s * 1e3)
    """Least playout delay, milliseconds."""


def bench_call(options: BenchCallOptions) -> dict[str, Any]:
    """Measure a call on this machine without drawing it: relay, senders and a decoding receiver.

    Reports the latency from source sample to decoded avatar, with its parts, rates and bitrates.
    """
    from pica_client.bench_call import BenchConfig, run_bench

    config = BenchConfig(
        stage=StageConfig(
            peers=options.peers, source=options.source, avatar=options.avatar, fps=options.fps
        ),
        seconds=options.seconds,
        playout=PlayoutConfig(floor_s=options.playout_floor_ms / 1e3),
    )
    result = run_bench(config)
    latency = result["latency_ms"]
    _say(
        f"{result['decoded_peers']} of {result['peers']} peers, source sample to decoded avatar: "
        f"p50 {latency['p50']} ms, p95 {latency['p95']} ms, p99 {latency['p99']} ms"
    )
    return result


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
