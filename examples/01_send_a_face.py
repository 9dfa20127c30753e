"""Send a face for one second to a relay in this process.

You learn the three parts of the sending half: a source (a face as a function of time), an avatar
(who the face becomes) and a link (where it goes). The statistics say what a talking face costs.
"""

import asyncio

from pica_client.endpoint.endpoint import Sender
from pica_client.publish.publisher import SenderConfig
from pica_client.sources import open_source
from pica_client.transport.config import LinkConfig
from pica_core.avatar.file import avatar_id, load_avatar
from pica_core.avatar.shipped import shipped_avatar_files
from pica_server.config.relay import RelayConfig
from pica_server.relay import Relay


async def main() -> None:
    file = shipped_avatar_files()[0]
    async with Relay(RelayConfig(port=0)) as relay:  # port 0: a free one, on loopback
        sender = Sender(
            SenderConfig(fps=30, seconds=1.0),
            LinkConfig(url=relay.url, room="kitchen", name="Ada"),
            open_source("performance:talk"),
            load_avatar(file),
            avatar_id(file),
        )
        stats = await sender.run()
    print(f"{stats['sent']} frames")
    print(f"{stats['payload_bps']} bit/s of payload, {stats['wire_bps']} bit/s on the wire")


asyncio.run(main())
