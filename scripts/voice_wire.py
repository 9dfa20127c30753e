"""What voices and faces take on the wire, and what a narrow downlink makes of them.

python scripts/voice_wire.py --rate 64 --record

A relay and senders with face and voice, each a process of its own, speak in turn with the sentences
that ship, without a pause in their turn. Two listen: one on loopback, one behind the proxy of
`bench.network` at so many kbit/s, TCP/IP headers included, 20 ms away, or, with ``--trouble``, on
the way of that row of `pica bench voice`. ``--ablate`` takes away that frames share messages. Bytes
are those of `stats.wire_bytes`: websocket and 40 of TCP/IP for each message, no acknowledgements;
``websocket_bps`` leaves the 40 out. Both play the voices into nothing: ``mouth_to_ear_ms`` and
``skew_ms`` (its size, held faces among them) are of every refresh of a face whose voice is heard.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from record_result import append_result, load_now

from pica_client.avatars.library import AvatarLibrary
from pica_client.bench.network.impairment import Impairment
from pica_client.bench.network.proxy import ImpairedProxy
from pica_client.bench.network.scenarios import BY_NAME
from pica_client.call.call import Call
from pica_client.call.held_lips import HeldLips
from pica_client.local_call.local_call import ROOM, LocalCall, LocalCallConfig
from pica_client.local_call.processes import Children
from pica_client.stats import TCP_IP_HEADER_BYTES, describe_machine
from pica_client.transport.config import LinkConfig
from pica_client.transport.receiver import Receiver
from pica_client.voice.mixer import VoiceMixer
from pica_client.voice.opus import OpusDecoder
from pica_client.voice.packet import FRAME_S, PACKET_FRAMES, VoicePacket

SETTLE_S = 4.0
"""From the first frames to those that count: the relay has learnt who is narrow."""


class Listener:
    """Somebody who only listens and looks, and what comes of it in the window."""

    def __init__(self, url: str, name: str, library: AvatarLibrary) -> None:
        self.call = Call(library)
        self.heard: dict[str, list[tuple[VoicePacket, float]]] = {}
        link = LinkConfig(url=url, room=ROOM, name=name)
        self.receiver = Receiver(link, self.call, on_voice=self._on_voice)
        self.mixer = VoiceMixer(OpusDecoder)
        self.call.heard_us = self.mixer.heard_us
        self.lips = self.call.lips = HeldLips(OpusDecoder)
        self.mixed = 0
        self.ages_ms: list[float] = []

    def _on_voice(self, peer_id: str, packet: VoicePacket, arrived_s: float) -> None:
        self.heard.setdefault(peer_id, []).append((packet, arrived_s))
        self.mixer.receive(peer_id, packet, arrived_s)
        self.lips.receive(peer_id, packet)

    def begin(self, now: float) -> None:
        """Count from now on."""
        self.heard.clear()
        self.ages_ms.clear()
        self.call.begin_window(now)
        counters = self.receiver.link.counters
        self._before = (counters.received_wire_bytes, counters.received_messages)

    def look(self, now: float) -> None:
        """Play what is due of the voices, and note how old the faces on the display are."""
        self.mixed = max(self.mixed, int(now / FRAME_S) - 10)
        while self.mixed * FRAME_S < now:
            self.mixer.mix(self.mixed * FRAME_S)
            self.mixed += 1
        faces = [face for face in self.call.faces(now) if face.latent is not None]
        self.ages_ms += [now * 1e3 - face.captured_us / 1e3 for face in faces]

    def row(self, now: float, seconds: float) -> dict[str, Any]:
        """Return what came in so many seconds."""
        counters = self.receiver.link.counters
        num_bytes = counters.received_wire_bytes - self._before[0]
        messages = counters.received_messages - self._before[1]
        voices = list(self.heard.values())
        lost = sum(
            (after.sequence - before.sequence - 1) % 65_536
            for voice in voices
            for (before, _), (after, _) in pairwise(voice)
        )
        delays_ms = [
            (arrived_s - PACKET_FRAMES * FRAME_S - packet.captured_us / 1e6) * 1e3
            for voice in voices
            for packet, arrived_s in voice
        ]
        stats = self.call.stats(now)
        concealed = [each["concealed_ratio"] for each in self.mixer.stats().values()]
        return {
            "packets": len(delays_ms),
            "lost": lost,
            "voice_delay_ms": summary(delays_ms),
            "mouth_to_ear_ms": self.call.delays_s.summary_ms(),
            "skew_ms": self.call.skews_s.summary_ms(),
            "concealed_ratio": float(np.mean(concealed)),
            "face_age_ms": summary(self.ages_ms),
            "faces_lost": stats["dropped"],
            "faces_concealed": stats["concealed"],
            "messages_per_s": round(messages / seconds, 1),
            "wire_bps": round(num_bytes * 8 / seconds),
            "websocket_bps": round((num_bytes - messages * TCP_IP_HEADER_BYTES) * 8 / seconds),
        }


def summary(values: list[float]) -> dict[str, float]:
    """Percentiles."""
    found = np.percentile(values, (50, 95, 99)) if values else (np.nan,) * 3
    return {f"p{p}": round(float(v), 1) for p, v in zip((50, 95, 99), found, strict=True)}


async def listen(
    url: str, way: Impairment, seconds: float, library: AvatarLibrary
) -> dict[str, Any]:
    """Let both listen for a while."""
    loop = asyncio.get_running_loop()
    async with ImpairedProxy(url, way) as proxy:
        both = {
            "near": Listener(url, "near", library),
            "narrow": Listener(proxy.url, "far", library),
        }
        running = [asyncio.create_task(each.receiver.run()) for each in both.values()]
        begin_s = loop.time() + SETTLE_S
        has_begun = False
        while (now := loop.time()) < begin_s + seconds:
            if now >= begin_s and not has_begun:
                has_begun = True
                for each in both.values():
                    each.begin(now)
            for each in both.values():
                each.look(now)
            await asyncio.sleep(1 / 60)
        rows = {name: each.row(now, seconds) for name, each in both.items()}
        for each in both.values():
            each.receiver.stop()
        await asyncio.gather(*running)
    return rows


def measure(options: argparse.Namespace, *arguments: str) -> dict[str, Any]:
    """Hold one call."""
    library = AvatarLibrary()
    config = LocalCallConfig(peers=options.peers, has_voices=True)
    with Children() as children:
        call = LocalCall(config, library, children, relay_arguments=arguments)
        way = Impairment(rate_bps=options.rate * 1e3)
        if options.trouble:
            way = BY_NAME[options.trouble].trouble
        rows = asyncio.run(listen(call.url, way, options.seconds, library))
        sent = call.finish()
    library.close()
    rows["uplinks"] = {
        name: {key: result[key] for key in ("wire_bps", "payload_bps", "sent", "voice")}
        for name, result in sent.items()
    }
    return rows


def main() -> None:
    """Read the command line, run, print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rate", type=float, default=64.0, help="kbit/s of the narrow downlink")
    ordered = [name for name, each in BY_NAME.items() if each.trouble.is_ordered]
    parser.add_argument("--trouble", choices=ordered, help="another way instead of a narrow one")
    parser.add_argument("--peers", type=int, default=4, help="who speak in turn; 1 never stops")
    parser.add_argument("--seconds", type=float, default=16.0, help="measured")
    parser.add_argument("--ablate", action="store_true", help="also without shared messages")
    parser.add_argument("--record", action="store_true", help="append to docs/results/voice-wire")
    options = parser.parse_args()
    load_before = load_now()
    trouble = options.trouble or f"rate-{options.rate:g}"
    figures = {"through": "proxy", "condition": trouble, "peers": options.peers}
    figures |= measure(options)
    if options.ablate:
        figures["without_ride"] = measure(options, "--without", "ride")
    figures["machine"] = describe_machine()
    print(json.dumps(figures))
    if options.record:
        command = " ".join(["scripts/voice_wire.py", *sys.argv[1:]])
        append_result("voice-wire", command, figures, load_before)


if __name__ == "__main__":
    main()
