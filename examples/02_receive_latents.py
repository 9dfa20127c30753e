"""Receive the latents of a sender in a room, each when it comes.

You learn the receiving half without any graphics: a `Call` knows who is there and decodes their
streams, a `Receiver` runs the network for it. A latent is 8 x 8 x 4 numbers; the pose of the head
travels beside it. A display asks for `Call.faces` instead, which come at an even pace.
"""

import asyncio

from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import ArrivedFace, Call
from pica_client.endpoint import Receiver, Sender
from pica_client.publish import SenderConfig, open_face
from pica_client.transport.connect import LinkConfig
from pica_server.config import RelayConfig
from pica_server.relay import Relay


async def main() -> None:
    library = AvatarLibrary()
    faces: list[ArrivedFace] = []

    def take(face: ArrivedFace) -> None:
        faces.append(face)
        if len(faces) % 15 == 1:
            print(f"{face.name}: latent {face.sample.latent.shape}, {face.sample.rotation} rad")

    async with Relay(RelayConfig(port=0)) as relay:
        link, config = LinkConfig(url=relay.url, name="Ada"), SenderConfig(seconds=2.0)
        sender = Sender(link, open_face("performance:talk", link, library, print, config=config))
        call = Call(library, on_face=take)
        receiver = Receiver(LinkConfig(url=relay.url, name="me"), call)
        receiving, sending = asyncio.create_task(receiver.run()), asyncio.create_task(sender.run())
        await sending
        receiver.stop()
        await receiving
    library.close()
    print(f"{len(faces)} latents")


asyncio.run(main())
