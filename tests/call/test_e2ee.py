"""Sealed calls through the real relay on the virtual clock: it caches, thins and forwards what it
cannot read."""

import asyncio
import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise

import pytest

pytest.importorskip("cryptography", reason="needs the extra seal")

from pica_client.e2ee.guard import Guard
from pica_client.e2ee.secret import RoomSecret
from pica_client.transport.connect import LinkConfig
from pica_client.transport.link import Link
from pica_protocol.frames import Frame
from pica_protocol.messages import Joined, PeerLeft, Track
from pica_protocol.session import ClientEvent
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from simnet.clock import current_network, in_virtual_time
from simnet.network import Wire

pytestmark = pytest.mark.call

SECRET = RoomSecret(bytes(range(32)))
FACE = b"a face of nobody but us"
FPS = 30


class Sealed:
    """A link with a guard, and all that came out of it.

    Attributes:
        frames: When each came, and the frame.
    """

    def __init__(self, name: str, *, host: str = "relay", publishes: bool = True) -> None:
        chance = random.Random(name)
        self.guard = Guard(SECRET, random_bytes=chance.randbytes)
        self.link = Link(
            LinkConfig(url=f"ws://{host}:8765", room="r", name=name),
            (Track(kind="face"),) if publishes else (),
            on_event=self._take,
        )
        self.link.guard = self.guard
        self.frames: list[tuple[float, Frame]] = []
        self.events: list[ClientEvent] = []
        self.joined_s = 0.0
        self.joined = asyncio.Event()

    def _take(self, event: ClientEvent, now: float) -> None:
        if isinstance(event, Frame):
            self.frames.append((now, event))
            return
        self.events.append(event)
        if isinstance(event, Joined):
            self.joined_s = now
            self.joined.set()

    async def publish(self, seconds: float) -> None:
        """Send a stream."""
        loop = asyncio.get_running_loop()
        begin_s = loop.time()
        for number in range(round(seconds * FPS)):
            await asyncio.sleep(begin_s + number / FPS - loop.time())
            self.link.send_frame(FACE, round(loop.time() * 1e6))


@asynccontextmanager
async def running(*peers: Sealed) -> AsyncIterator[None]:
    """Keep links up, and let them go in good order."""
    tasks = [asyncio.create_task(peer.link.run()) for peer in peers]
    for peer in peers:
        await peer.joined.wait()
    try:
        yield
    finally:
        for peer in peers:
            peer.link.leave()
        await asyncio.gather(*tasks)


@in_virtual_time
async def test_a_late_joiner_sees_a_face_one_round_trip_and_one_frame_after_it_joined() -> None:
    network = current_network()
    for host, delay_s in (("ada", 0.05), ("late", 0.08)):
        network.route(host, up=Wire(delay_s=delay_s), down=Wire(delay_s=delay_s))
    round_trip_s = 2 * (0.05 + 0.08)
    async with Relay(RelayConfig(port=8765)):
        ada, early = Sealed("ada", host="ada"), Sealed("early", publishes=False)
        late = Sealed("late", host="late", publishes=False)
        async with running(ada, early):
            publishing = asyncio.create_task(ada.publish(10))
            await asyncio.sleep(5)
            async with running(late):
                await publishing
    arrived_s, first = late.frames[0]
    assert first.captured_us / 1e6 > late.joined_s
    assert arrived_s - late.joined_s <= round_trip_s + 1 / FPS + 1e-6
    # The newest frame that the relay kept, and what came before the key, stayed shut.
    assert late.guard.counters.unreadable > 1
    assert early.guard.counters.unreadable == 0


@in_virtual_time
async def test_those_who_stay_miss_nothing_when_somebody_leaves() -> None:
    network = current_network()
    network.route("slow", up=Wire(delay_s=0.2), down=Wire(delay_s=0.2, jitter_s=0.03))
    async with Relay(RelayConfig(port=8765)):
        ada, ben, cho = Sealed("ada"), Sealed("ben", host="slow"), Sealed("cho")
        async with running(ada, ben):
            publishing = [asyncio.create_task(peer.publish(10)) for peer in (ada, ben)]
            async with running(cho):
                await asyncio.sleep(3)
                changes = ada.guard.counters.key_changes
            before = ben.guard.counters.unreadable, ada.guard.counters.unreadable
            await asyncio.gather(*publishing)
            assert any(isinstance(event, PeerLeft) for event in ada.events)
            assert ada.guard.counters.key_changes == changes + 1
            assert (ben.guard.counters.unreadable, ada.guard.counters.unreadable) == before
            seen_s = [arrived_s for arrived_s, _ in ben.frames]
    gaps_s = [after - before for before, after in pairwise(seen_s)]
    assert max(gaps_s) < 0.3  # the jitter of the network, and nothing on top
