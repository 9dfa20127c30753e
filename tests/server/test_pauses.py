"""A relay, or the way to it, that stands still for a while: it costs nobody their place."""

import asyncio
import os
import select
import signal
import socket
from collections.abc import Iterator

import pytest

from pica_protocol.session import Closed
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from simnet.clock import current_network, in_virtual_time
from simnet.peers import now, peer_in_room
from simnet.relays import RelayProcess, start_relay

pytestmark = pytest.mark.call

if os.name == "nt":
    pytest.skip("stops the relay with Unix signals", allow_module_level=True)


@in_virtual_time
async def test_a_proxy_that_stalls_expels_nobody_whatever_their_rate() -> None:
    async with (
        Relay(RelayConfig()),
        peer_in_room("ws://train:8765", "Ada") as ada,
        peer_in_room("ws://train:8765", "Bob") as bob,
        peer_in_room("ws://relay:8765", "Cleo", tracks=()) as cleo,
    ):
        sending = [
            asyncio.create_task(peer.publish(num_frames=round(25 * fps), fps=fps))
            for peer, fps in ((ada, 30), (bob, 120))
        ]
        await asyncio.sleep(5.0)
        current_network().stall("train", 11.5)
        await asyncio.gather(*sending)
        await asyncio.sleep(0.1)
        assert not ada.told(Closed)
        assert not bob.told(Closed)
        assert max(now() - at for at, _ in cleo.arrivals[-2:]) < 0.2
        assert cleo.delays_s[-1] < 0.01


@pytest.fixture
def relay() -> Iterator[RelayProcess]:
    process = start_relay("--port", "0", "--limits.bytes-per-s", "24000")
    assert process.stderr is not None
    node = RelayProcess(process, process.stderr.readline().split()[-1])
    yield node
    process.send_signal(signal.SIGCONT)
    process.kill()
    process.communicate()


@pytest.mark.asyncio
async def test_the_kernel_holds_little_for_a_relay_that_does_not_read(relay: RelayProcess) -> None:
    """So who sends feels it, and thins its own stream."""
    async with peer_in_room(relay.url, "Ada") as ada:
        sock = ada.websocket.transport.get_extra_info("socket")
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, 2048)
        relay.freeze()
        num_bytes = 0
        with socket.socket(fileno=os.dup(sock.fileno())) as own:
            while select.select([], [own], [], 0.5)[1]:
                num_bytes += own.send(bytes(50))
                await asyncio.sleep(0.0002)
        ada.websocket.transport.abort()
    assert num_bytes < 32_768
