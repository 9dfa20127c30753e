"""Hold a call of four: a relay, three senders and a receiver, in one process on loopback.

You learn how the parts are put together, and how long a face is on its way: on loopback a
millisecond or so. A display adds what its playout buffer waits.
"""

import asyncio

from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import ArrivedFace, Call
from pica_client.endpoint import Receiver, Sender
from pica_client.publish import SenderConfig, open_face
from pica_client.stats import percentile
from pica_client.transport.connect import LinkConfig
from pica_server.config import RelayConfig
from pica_server.relay import Relay

NAMES = ("Ada", "Ben", "Cho")
CONFIG = SenderConfig(seconds=2.0)


async def main() -> None:
    library = AvatarLibrary()
    delays_ms: dict[str, list[float]] = {name: [] for name in NAMES}

    def take(face: ArrivedFace) -> None:
        # Senders and receiver share a clock here; across machines this needs an offset.
        delays_ms[face.name].append((face.arrived_s - face.captured_us / 1e6) * 1000)

    async with Relay(RelayConfig(port=0)) as relay:
        call = Call(library, on_face=take)
        receiver = Receiver(LinkConfig(url=relay.url, name="me"), call)
        receiving = asyncio.create_task(receiver.run())
        links = [LinkConfig(url=relay.url, name=name) for name in NAMES]
        senders = [
            Sender(link, open_face(f"performance:talk#{seed}", link, library, print, config=CONFIG))
            for seed, link in enumerate(links)
        ]
        await asyncio.gather(*(sender.run() for sender in senders))
        receiver.stop()
        await receiving
        forwarded = relay.stats()
    library.close()
    for name, delays in delays_ms.items():
        ordered = sorted(delays)
        p50, p99 = percentile(ordered, 50), percentile(ordered, 99)
        print(f"{name}: {len(ordered)} faces, delay p50 {p50:.1f} ms, p99 {p99:.1f} ms")
    print(f"the relay has {forwarded['open_connections']} connections left")


asyncio.run(main())
