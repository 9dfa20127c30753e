"""Send a face for one second to a relay in this process.

You learn the three parts of the sending half: a source (a face as a function of time), an avatar
(who the face becomes) and a link (where it goes). The statistics say what a talking face costs.
"""

import asyncio
from contextlib import closing

from pica_client.avatars.library import AvatarLibrary
from pica_client.endpoint import Sender
from pica_client.publish import SenderConfig, open_face
from pica_client.transport.connect import LinkConfig
from pica_server.config import RelayConfig
from pica_server.relay import Relay


async def main() -> None:
    config = SenderConfig(fps=30, seconds=1.0)
    async with Relay(RelayConfig(port=0)) as relay:  # port 0: a free one, on loopback
        link = LinkConfig(url=relay.url, room="kitchen", name="Ada")
        with closing(AvatarLibrary()) as library:
            face = open_face("performance:talk", link, library, print, config=config)
        sender = Sender(link, face)
        await sender.run()
    stats = sender.stats()
    print(f"{stats['sent']} frames")
    print(f"{stats['payload_bps']} bit/s of payload, {stats['wire_bps']} bit/s on the wire")


asyncio.run(main())
