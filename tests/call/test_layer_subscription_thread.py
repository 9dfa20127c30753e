"""Subscriptions from the drawing thread, on a real clock; the receiver has a thread of its own."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable

import pytest

from helpers.senders import LoadedAvatars, make_senders
from helpers.toy import make_toy_avatar
from pica_client.call.call import Call
from pica_client.publish.sender import SenderConfig
from pica_client.transport.config import LinkConfig
from pica_client.transport.receiver import Receiver
from pica_server.config.relay import RelayConfig
from pica_server.relay import Relay

pytestmark = pytest.mark.realtime

AVATARS = {"7" * 64: make_toy_avatar()}
PATIENCE_S = 30.0
SILENCE_S = 0.4
"""Twelve frames at the rate of the sender."""


def received(receiver: Receiver) -> int:
    return sum(health.received for health in receiver.call.health().values())


def is_silent(receiver: Receiver, counts: list[int]) -> bool:
    """Whether nothing came since the last look."""
    counts.append(received(receiver))
    return counts[-1] == counts[-2]


async def until(condition: Callable[[], bool], every_s: float = 0.01) -> None:
    while not condition():  # noqa: ASYNC110 - what is waited for happens in another thread
        await asyncio.sleep(every_s)


def test_a_subscription_of_another_thread_reaches_the_relay_and_is_taken_back() -> None:
    async def call() -> None:
        async with asyncio.timeout(PATIENCE_S), Relay(RelayConfig(port=0)) as relay:
            config = LinkConfig(url=relay.url, room="kitchen", name="ada")
            (sender,) = make_senders([config], list(AVATARS.items()), config=SenderConfig(), seed=1)
            sending = asyncio.create_task(sender.run())
            viewer = LinkConfig(url=relay.url, room="kitchen", name="viewer")
            receiver = Receiver(viewer, Call(LoadedAvatars(AVATARS)), rng=random.Random(1))
            receiver.call.subscribe("nobody", 0, time.monotonic())  # before it runs: no error
            with receiver:
                await until(lambda: received(receiver) > 10)
                (peer_id,) = receiver.call.names()
                receiver.call.subscribe(peer_id, 0, time.monotonic())
                counts = [-1]
                await until(lambda: is_silent(receiver, counts), SILENCE_S)
                receiver.call.subscribe(peer_id, 1, time.monotonic())
                await until(lambda: received(receiver) > counts[-1] + 10)
                receiver.stop()
                await until(lambda: not receiver.is_connected)
            sender.stop()
            await sending

    asyncio.run(call())
