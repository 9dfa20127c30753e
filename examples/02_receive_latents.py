"""Receive the latents of a sender in a room, each when it is due.

You learn the receiving half without any graphics: a `Call` knows who is there and holds their
playout buffers, a `Receiver` runs the network for it. A latent is 8 x 8 x 4 numbers; the pose of
the head travels beside it.
"""

import asyncio

from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import Call
from pica_client.endpoint.endpoint import Receiver, Sender
from pica_client.publish.publisher import SenderConfig, open_face
from pica_client.transport.config import LinkConfig
from pica_server.config.relay import RelayConfig
from pica_server.relay import Relay


async def main() -> None:
    loop = asyncio.get_running_loop()
    library = AvatarLibrary()
    async with Relay(RelayConfig(port=0)) as relay:
        link, config = LinkConfig(url=relay.url, name="Ada"), SenderConfig(seconds=2.0)
        sender = Sender(link, open_face("performance:talk", link, library, print, config=config))
        call = Call(library)
        receiver = Receiver(LinkConfig(url=relay.url, name="me"), call)
        receiving, sending = asyncio.create_task(receiver.run()), asyncio.create_task(sender.run())
        num_frames = 0
        while not sending.done():
            receiver.arrived.clear()
            for due in call.due_frames(loop.time()):
                num_frames += 1
                if num_frames % 15 == 1:
                    face = due.frame.sample
                    print(f"{due.name}: latent {face.latent.shape}, rotation {face.rotation}")
            wake_s = call.next_timer() or loop.time() + 0.1  # a frame that is due, or news
            try:
                async with asyncio.timeout_at(wake_s):
                    await receiver.arrived.wait()
            except TimeoutError:
                pass
        receiver.stop()
        await receiving
    library.close()
    print(f"{num_frames} latents")


asyncio.run(main())
