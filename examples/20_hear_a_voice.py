"""Speak and be heard: a relay, a sender with face and voice, and a listener.

You learn how a voice travels beside a face: packets of 40 ms with the time of their capture, and
nothing in silence.
"""

import asyncio
from dataclasses import replace

import numpy as np

from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import Call, Ears
from pica_client.endpoint import Receiver, Sender
from pica_client.publish import SenderConfig, open_face
from pica_client.transport.connect import LinkConfig
from pica_client.voice.opus import OpusDecoder, level_of
from pica_client.voice.source import SoundSource, VoicePublisher, shipped_speech
from pica_protocol.frames import Frame
from pica_server.config import RelayConfig
from pica_server.relay import Relay


class Listener(Ears):
    """Keeps the packets of all voices, with their times of arrival."""

    def __init__(self) -> None:
        self.heard: list[tuple[Frame, float]] = []

    def receive(self, peer_id: str, packet: Frame, arrived_s: float) -> None:
        """See `Ears.receive`."""
        self.heard.append((packet, arrived_s))


async def main() -> None:
    listener = Listener()
    library = AvatarLibrary()
    async with Relay(RelayConfig(port=0)) as relay:
        receiver = Receiver(LinkConfig(url=relay.url, name="me"), Call(library, ears=listener))
        receiving = asyncio.create_task(receiver.run())
        link, config = LinkConfig(url=relay.url, name="Ada"), SenderConfig(seconds=3.0)
        own = open_face("performance:talk", link, library, print, config=config)
        sender = Sender(link, replace(own, voice=VoicePublisher(SoundSource(shipped_speech()))))
        await sender.run()
        receiver.stop()
        await receiving
    library.close()
    sent, heard = sender.stats(), listener.heard

    decoder = OpusDecoder()  # a jitter buffer stands here in a call: it decides what is heard when
    parts = [decoder.decode(packet.payload) for packet, _ in heard]
    # Sender and receiver share a clock here; a packet is 40 ms old when it is complete.
    delays_ms = [(arrived_s - packet.captured_us / 1e6) * 1e3 - 40 for packet, arrived_s in heard]
    seconds, loudest = sum(map(len, parts)) / 48_000, min(map(level_of, parts))
    print(f"{len(heard)} packets, {seconds:.1f} s of sound, at most -{loudest} dB")
    print(f"relayed within {np.percentile(delays_ms, 95):.1f} ms, 95 of 100 times")
    print(f"{sent['sent']} faces and {sent['voice']['sent']} packets: {sent['wire_bps']} bit/s")


asyncio.run(main())
