"""The real relay with much to do, on a virtual clock: who waits for whom, and for how long."""

import asyncio

import pytest

from pica_server.config.relay import LimitsConfig, RelayConfig
from pica_server.relay import Relay
from simnet.clock import in_virtual_time
from simnet.peers import now, peer_in_room

pytestmark = pytest.mark.call

URL = "ws://relay:8765"


@in_virtual_time
async def test_sockets_that_never_speak_do_not_pile_up_and_free_their_places() -> None:
    loop = asyncio.get_running_loop()
    config = RelayConfig(handshake_timeout_s=3, limits=LimitsConfig(handshakes=10))
    async with Relay(config) as relay, peer_in_room(URL, "Ada") as ada:
        lost = []

        class Mute(asyncio.Protocol):
            def connection_lost(self, exc: Exception | None) -> None:
                lost.append(now())

        for _ in range(50):
            await loop.create_connection(Mute, "relay", 8765)
        await asyncio.sleep(0.1)
        assert len(lost) == 40
        assert relay.stats()["limits_hit"] == {"sockets": 40}
        await asyncio.sleep(3)
        assert len(lost) == 50
        async with peer_in_room(URL, "Bob"):
            assert len(ada.session.peers) == 1


@in_virtual_time
async def test_a_relay_that_stops_does_not_wait_for_sockets_that_say_nothing() -> None:
    loop = asyncio.get_running_loop()
    async with Relay(RelayConfig(handshake_timeout_s=300)):
        for _ in range(50):
            await loop.create_connection(asyncio.Protocol, "relay", 8765)
        await asyncio.sleep(1)
        stops_s = now()
    assert now() - stops_s < 1


@in_virtual_time
async def test_what_comes_late_and_all_at_once_is_passed_on_whole() -> None:
    async with (
        Relay(RelayConfig()),
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob", tracks=()) as bob,
    ):
        payloads = [bytes([index]) for index in range(12)]
        messages: list[bytes] = []
        for payload in payloads:
            captured_us = round(now() * 1e6)
            ada.session.send_frame(payload, captured_us)
            messages += ada.session.messages_to_send(now())
        for message in messages:
            await ada.websocket.send(message)
        await asyncio.sleep(0.05)
        assert [frame.payload for _, frame in bob.arrivals] == payloads
