"""Write your own source: a face that nods and blinks, and send it.

You learn that a source is one method, `frame_at`: the face at a moment of the source's time. It
knows no clock and never waits; the sender does the pacing. A tracker or a file is a source in
the same way.
"""

import asyncio
import math

import numpy as np

from pica_client.endpoint import Sender
from pica_client.publish import Outgoing, Publisher, SenderConfig
from pica_client.transport.connect import LinkConfig
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT, ExpressionFrame
from pica_core.avatar.file import avatar_id, load_avatar, shipped_avatar_files
from pica_server.config import RelayConfig
from pica_server.relay import Relay


class Nodding:
    """A head that nods once a second and blinks every second nod."""

    def frame_at(self, time_s: float) -> ExpressionFrame:
        """The face at a moment, seconds since the source began."""
        arkit = np.zeros(NUM_ARKIT, np.float32)
        blink = max(0.0, math.sin(math.pi * time_s)) ** 16
        arkit[[ARKIT_INDEX["eyeBlinkLeft"], ARKIT_INDEX["eyeBlinkRight"]]] = blink
        nod_rad = 0.1 * math.sin(2 * math.pi * time_s)
        return ExpressionFrame(
            captured_us=round(time_s * 1e6),
            arkit=arkit,
            rotation=np.array([nod_rad, 0, 0], np.float32),
        )


async def main() -> None:
    file = shipped_avatar_files()[1]
    async with Relay(RelayConfig(port=0)) as relay:
        link = LinkConfig(url=relay.url, name="Nod")
        config = SenderConfig(seconds=2.0)
        face = Publisher(config, Nodding(), load_avatar(file), avatar_id(file))
        sender = Sender(link, Outgoing(face=face))
        await sender.run()
    stats = sender.stats()
    print(f"{stats['sent']} frames sent, {stats['payload_bps']} bit/s")


asyncio.run(main())
