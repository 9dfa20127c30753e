"""The same call as the demo's without drawing: every latent is decoded to its maps as soon as a
playout that moves no face between two frames lets it go. The time from the tracker's sample to the
decoded maps is what counts; it is told without the wait in the playout, too.

What it does not show: real networks (all is loopback; `voice` imposes bad ones on a virtual clock),
displays, and more machines than one.
Wall-clock numbers hold for this machine under its present load.
"""

import asyncio
import contextlib
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import numpy as np
from cyclopts import Parameter

from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import ArrivedFace, Call
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool
from pica_client.decode.request import DecodeRequest
from pica_client.endpoint import Receiver
from pica_client.errors import CallProcessError, check_ranges
from pica_client.local_call import local_call
from pica_client.local_call.processes import Children
from pica_client.playout.buffer import CEILING_S, FLOOR_S
from pica_client.playout.sender_clock import WINDOW_S, Transit
from pica_client.stats import describe_machine, summarise_ms
from pica_client.system import say, terminate_as_interrupt
from pica_client.transport.connect import LinkConfig

WARM_UP_S = WINDOW_S
"""Between the last peer's first frame and the first that counts: so long does a playout wait for
what was late while the call began."""
READY_TIMEOUT_S = 60.0
"""How long decoders may take to get ready."""
DECODE_THREADS = 2
"""Decodes that may run at once (chosen: five peers need 150 a second; one thread is enough for
block G, two keep up with blocks of up to 10 ms)."""
MAX_FRAMES = 200_000
"""Frames a bench remembers: 22 minutes of five peers at 30 a second."""
FRONT = np.array([0, 0, 1], np.float32)
"""View direction of every decode: the camera in front of the face; it does not change the cost."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchConfig:
    """What to measure; the options of `pica bench call`."""

    call: Annotated[local_call.LocalCallConfig, Parameter(name="*")] = field(
        default_factory=local_call.LocalCallConfig
    )
    seconds: float = 20.0
    """Measured time, seconds."""

    def __post_init__(self) -> None:
        check_ranges(self, seconds=(0.1, 600))


class _Frame(NamedTuple):
    """One decoded frame, seconds on the clock that all processes of the call share."""

    name: str
    captured_s: float
    waited_s: float
    """In the playout."""
    decoded_s: float


class _Decoding:
    """Decodes every frame that arrives once it is due, and remembers when; `worn` are identities of
    avatars by the names of their wearers."""

    def __init__(self, library: AvatarLibrary, worn: Mapping[str, str]) -> None:
        self.pool = DecodePool(OnnxDecoder, workers=DECODE_THREADS)
        for name, identity in worn.items():
            self.pool.add(name, library.load(identity))
        self.pool.wait_idle(READY_TIMEOUT_S)  # to build a decoder makes frames late
        self.frames: deque[_Frame] = deque(maxlen=MAX_FRAMES)
        self.errors = 0
        self._transits: dict[str, Transit] = {}
        self._arrived_s: dict[tuple[str, int], float] = {}

    def receive(self, face: ArrivedFace) -> None:
        """Take a face that came just now; it is decoded as late as nearly all others come."""
        captured_s = face.captured_us / 1e6
        transit = self._transits.setdefault(face.name, Transit(face.arrived_s - captured_s))
        transit.receive(captured_s, face.arrived_s)
        wait_s = min(FLOOR_S + transit.jitter_s, CEILING_S)
        due_s = captured_s + transit.fastest_s + wait_s
        asyncio.get_running_loop().call_at(due_s, self._decode, face)

    def _decode(self, face: ArrivedFace) -> None:
        self.collect()
        self._arrived_s[face.name, face.captured_us] = face.arrived_s
        self.pool.submit(face.name, DecodeRequest(face.sample.latent, FRONT, face.captured_us))

    def collect(self) -> None:
        """Take what has been decoded."""
        for result in self.pool.take_results():
            self.errors += result.maps is None
            arrived_s = self._arrived_s.pop((result.slot, result.captured_us), result.submitted_s)
            waited_s = result.submitted_s - arrived_s
            captured_s = result.captured_us / 1e6
            self.frames.append(_Frame(result.slot, captured_s, waited_s, result.finished_s))


def bench_call(options: BenchConfig) -> dict[str, Any]:
    """Measure a call on this machine without drawing it: relay, senders and a decoding receiver.

    Reports the latency from source sample to decoded avatar, and bitrates.

    Raises:
        ClientError: A source, an avatar or a process is not as it must be; a call in which a
            sender crashed is no measurement.
    """
    library = AvatarLibrary()
    with terminate_as_interrupt(), contextlib.closing(library), Children() as children:
        local = local_call.LocalCall(options.call, library, children)
        result = asyncio.run(_measure(options, local, library))
    latency, alone = result["latency_ms"], result["without_playout_ms"]
    say(
        f"{result['decoded_peers']} of {result['peers']} peers, source sample to decoded avatar: "
        f"p50 {latency['p50']} ms, p95 {latency['p95']} ms, p99 {latency['p99']} ms; without the "
        f"playout's wait p50 {alone['p50']} ms, p99 {alone['p99']} ms"
    )
    return result


async def _measure(
    config: BenchConfig, local: local_call.LocalCall, library: AvatarLibrary
) -> dict[str, Any]:
    link = LinkConfig(
        url=local.url,
        room=local_call.ROOM,
        name="bench",
        connect_timeout_s=local_call.JOIN_TIMEOUT_S,
        secret_file=local.secret_file,
    )
    decoding = _Decoding(library, local.worn)
    call = Call(library, on_face=decoding.receive)
    receiver = Receiver(link, call)
    loop = asyncio.get_running_loop()
    receiving = asyncio.create_task(receiver.run())
    try:
        deadline = loop.time() + local_call.JOIN_TIMEOUT_S
        while call.num_live < len(local.worn):
            await _pause(receiving)
            local.check()
            if loop.time() > deadline:
                raise CallProcessError(
                    f"{call.num_live} of {len(local.worn)} peers were seen within "
                    f"{local_call.JOIN_TIMEOUT_S:g} s"
                )
        await _pause(receiving, WARM_UP_S)
        begin_s = loop.time()
        call.begin_window(begin_s)
        decoding.frames.clear()
        say(f"measuring {config.seconds:g} s of {len(local.worn)} peers")
        while (left_s := begin_s + config.seconds - loop.time()) > 0:
            await _pause(receiving, min(left_s, local_call.CHECK_INTERVAL_S))
            local.check()
        received = receiver.stats(loop.time())
        seconds = loop.time() - begin_s
        decoding.collect()
        frames = [frame for frame in decoding.frames if frame.captured_s >= begin_s]
        receiver.stop()
        await receiving
    finally:
        receiving.cancel()
        await asyncio.gather(receiving, return_exceptions=True)
        decoding.pool.close()
    sent = await asyncio.to_thread(local.finish)
    return {
        "peers": len(local.worn),
        "decoded_peers": len({frame.name for frame in frames}),
        "seconds": round(seconds, 2),
        "latency_ms": summarise_ms(frame.decoded_s - frame.captured_s for frame in frames),
        "without_playout_ms": summarise_ms(
            frame.decoded_s - frame.captured_s - frame.waited_s for frame in frames
        ),
        "bitrate_bps": local_call.bitrates(sent),
        "concealed": received["concealed"],
        "errors": received["errors"]
        + decoding.errors
        + sum(result["errors"] for result in sent.values()),
        "machine": describe_machine(),
    }


async def _pause(
    receiving: asyncio.Task[None], seconds: float = local_call.CHECK_INTERVAL_S
) -> None:
    """Sleep, unless receiving fails: then raise its error."""
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(asyncio.shield(receiving), seconds)
