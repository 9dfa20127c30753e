"""One's own face is seen as the others see it: after the codec, and muted like there."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from helpers.senders import LoadedAvatars
from helpers.stream_toy import stream_avatar
from pica_client.call.call import Call, Reflection
from pica_client.endpoint import Receiver
from pica_client.publish import Outgoing, Publisher, SenderConfig
from pica_client.sources import open_source
from pica_client.transport.connect import LinkConfig
from pica_core.avatar.arkit import ExpressionFrame
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from simnet.clock import in_virtual_time

pytestmark = pytest.mark.call

AVATAR_ID = "5" * 64


class Still:
    """A face that does not move."""

    def __init__(self, face: ExpressionFrame) -> None:
        self._face = face

    def frame_at(self, time_s: float) -> ExpressionFrame:
        return replace(self._face, captured_us=round(time_s * 1e6))


@in_virtual_time
async def test_ones_own_face_is_what_the_others_see_and_not_what_the_tracker_saw() -> None:
    avatar = stream_avatar()
    source = open_source("performance:talk")
    publisher = Publisher(SenderConfig(quality=0), source, avatar, AVATAR_ID)
    others = Call(LoadedAvatars({AVATAR_ID: avatar}))
    loop = asyncio.get_running_loop()
    async with Relay(RelayConfig(port=0)) as relay:
        port = relay.url.rpartition(":")[2]
        mine = Receiver(
            LinkConfig(url=f"ws://ada:{port}", name="Ada"),
            Call(LoadedAvatars({})),
            Outgoing(face=publisher),
        )
        theirs = Receiver(LinkConfig(url=f"ws://ben:{port}", name="Ben"), others)
        running = [asyncio.create_task(each.run()) for each in (mine, theirs)]
        await asyncio.sleep(3)
        reflection = Reflection(avatar, publisher.track)
        publisher.watch(reflection.receive)  # in the middle of a call
        await asyncio.sleep(2)
        publisher.replace_source(Still(source.frame_at(5.0)))  # two playout delays show one face
        await asyncio.sleep(3)
        (own,) = reflection.call.faces(loop.time())
        (seen,) = others.faces(loop.time())
        assert own.latent is not None
        assert seen.latent is not None
        assert own.status == "live"
        assert np.abs(own.latent - seen.latent).max() < 1e-5
        encoder = ExpressionEncoder(avatar)
        tracked = [encoder.encode(source.frame_at(at / 30).arkit) for at in range(140, 156)]
        assert min(float(np.abs(own.latent - each).max()) for each in tracked) > 1e-3
        publisher.mode = "muted"
        await asyncio.sleep(3)
        (own,) = reflection.call.faces(loop.time())
        assert own.status == "stale"
        for each in (mine, theirs):
            each.stop()
        await asyncio.gather(*running)
