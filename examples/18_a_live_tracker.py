"""Be in a call with a phone's tracker: here a pretended phone, over UDP on this machine.

You learn what lies between a tracker and the wire: a source listens, puts each sample on our
clock, smooths it, and shows the face a little later than it was seen, so that it moves evenly. A
real phone sends the same datagrams to port 11111.
"""

import asyncio
import math
import socket
import struct
import time

from pica_client.endpoint import Sender
from pica_client.publish import Outgoing, Publisher, SenderConfig
from pica_client.sources.registry import open_live
from pica_client.sources.tracker import UdpTracker
from pica_client.transport.connect import LinkConfig
from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.avatar.file import avatar_id, load_avatar, shipped_avatar_files
from pica_server.config import RelayConfig
from pica_server.relay import Relay


def datagram(frame: int) -> bytes:
    """What Live Link Face sends at 60 a second: a person says "aah" and shakes the head."""
    values = [0.0] * 61
    values[ARKIT_INDEX["jawOpen"]] = 0.4 + 0.4 * math.sin(frame / 8)
    values[52] = 0.2 * math.sin(frame / 30)  # yaw, radians
    names = b"".join(struct.pack(">i", len(name)) + name for name in (b"a-device", b"me"))
    return b"\x06" + names + struct.pack(">ifiiB61f", frame, 0.0, 60, 1, 61, *values)


async def play_phone(port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as phone:
        for frame in range(10_000):
            phone.sendto(datagram(frame), ("127.0.0.1", port))
            await asyncio.sleep(1 / 60)


async def main() -> None:
    file = shipped_avatar_files()[0]
    source = open_live("livelink", "0")  # for a real phone: open_source("livelink:lan")
    assert isinstance(source, UdpTracker)
    async with Relay(RelayConfig(port=0)) as relay:
        phone = asyncio.create_task(play_phone(source.port))
        config = SenderConfig(seconds=2.0)
        face = Publisher(config, source, load_avatar(file), avatar_id(file))
        sender = Sender(LinkConfig(url=relay.url, name="Ada"), Outgoing(face=face))
        sending = asyncio.create_task(sender.run())
        await asyncio.sleep(1.0)
        jaw = source.frame_at(time.monotonic()).arkit[ARKIT_INDEX["jawOpen"]]
        print(f"the jaw is open by {jaw:.2f}; shown {source.face.delay_s * 1000:.0f} ms after")
        await sending
        stats = sender.stats()
        phone.cancel()
    print(f"{stats['sent']} faces went")


asyncio.run(main())
