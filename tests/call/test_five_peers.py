"""A call of five on the virtual clock: the real websockets library, relay, senders and receiver.

Every peer has its own network. Encoding is real numpy with a toy avatar; decoding to position maps
is left out, because ONNX Runtime needs threads and virtual time has none. What is measured here is
capture to arrival. Code takes no time on a virtual clock, so these are the delays of the network.
"""

import asyncio
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

import pytest

from helpers.senders import LoadedAvatars, link_of, make_senders, run_senders
from helpers.toy import make_toy_avatar
from pica_client.bench.impairment import Impairment
from pica_client.call.call import ArrivedFace, Call
from pica_client.endpoint import Receiver
from pica_client.publish import SenderConfig
from pica_client.stats import percentile
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from simnet.clock import current_network, in_virtual_time
from simnet.network import Wire

pytestmark = pytest.mark.call

PEERS = ("ada", "ben", "cho", "dee", "eve")
SECONDS = 15.0
AVATARS = {seed * 64: make_toy_avatar(seed=int(seed)) for seed in "12"}
FRAME_BYTES = 22 + 8
"""A frame of a toy avatar that talks, about, with its header."""


@dataclass
class Watched:
    """What the receiver of a call saw."""

    delays_s: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    stats: dict[str, Any] = field(default_factory=dict)

    def take(self, face: ArrivedFace) -> None:
        """Note how long a face was on its way."""
        self.delays_s[face.name].append(face.arrived_s - face.captured_us / 1e6)

    def delay_percentile(self, name: str, percent: float) -> float:
        return percentile(sorted(self.delays_s[name]), percent)

    def peer(self, name: str) -> dict[str, Any]:
        (found,) = [peer for peer in self.stats["peers"] if peer["name"] == name]
        return dict(found)


async def hold_call(
    networks: dict[str, Impairment], *, down: Impairment | None = None
) -> tuple[Watched, list[dict[str, Any]], dict[str, Any]]:
    """Five senders, a relay and a receiver, measured for `SECONDS` after four of warming up: what
    the receiver saw, what the senders say, what the relay says."""
    loop, network, watched = asyncio.get_running_loop(), current_network(), Watched()
    async with Relay(RelayConfig(port=0)) as relay:
        for name in PEERS:
            network.route(name, up=networks.get(name, Wire()))
        network.route("viewer", down=down)
        senders = make_senders(
            [link_of(relay.url, name) for name in PEERS],
            list(AVATARS.items()),
            config=SenderConfig(seconds=SECONDS + 6),
        )
        call = Call(LoadedAvatars(AVATARS), on_face=watched.take)
        receiver = Receiver(link_of(relay.url, "viewer"), call)
        async with asyncio.TaskGroup() as tasks:
            sending = tasks.create_task(run_senders(senders))
            tasks.create_task(receiver.run())
            await asyncio.sleep(4)
            call.begin_window(loop.time())
            watched.delays_s.clear()
            for _ in range(round(60 * SECONDS)):
                await asyncio.sleep(1 / 60)
                call.faces(loop.time())
            watched.stats = receiver.stats(loop.time())
            receiver.stop()
        return watched, sending.result(), relay.stats()


@in_virtual_time
async def test_trouble_of_one_network_is_felt_where_it_is_and_nowhere_else() -> None:
    # Half of what 30 frames a second need: every other frame is overtaken before it is sent.
    thin = Wire(rate_bps=0.5 * 30 * (FRAME_BYTES + 9) * 8, queue_bytes=600)
    jitter = Wire(delay_s=0.02, jitter_s=0.02)
    watched, sent, relay_stats = await hold_call({"ben": jitter, "cho": thin})
    waits_ms = {name: watched.peer(name)["playout_delay_ms"] for name in PEERS}
    assert 45 <= waits_ms["ben"] <= 90  # an interval, and 95 % of the jitter
    assert watched.peer("ben")["latents_per_s"] == pytest.approx(30, rel=0.02)
    assert watched.peer("ben")["concealed_ratio"] <= 0.02
    assert sent[PEERS.index("cho")]["replaced"] > 200
    assert 12 <= watched.peer("cho")["latents_per_s"] <= 18
    # The newest that fits: the write buffer holds fourteen frames at fifteen a second.
    assert watched.delay_percentile("cho", 99) <= 1.3
    for name in set(PEERS) - {"ben", "cho"}:
        assert waits_ms[name] == pytest.approx(1000 / 30, abs=1)
        assert watched.peer(name)["latents_per_s"] == pytest.approx(30, rel=0.02)
        assert watched.peer(name)["concealed_ratio"] == 0
        assert watched.delay_percentile(name, 99) <= 0.0005
    assert watched.stats["errors"] == 0
    assert [each["reconnects"] for each in sent] == [0] * 5
    # Senders take nothing of each other.
    assert relay_stats["frames_out"] <= relay_stats["frames_in"]


@in_virtual_time
async def test_a_slow_receiver_gets_every_peer_at_a_lower_rate_within_bounded_delay() -> None:
    slow = Wire(delay_s=0.03, rate_bps=0.56 * 5 * 30 * FRAME_BYTES * 8, queue_bytes=600)
    watched, _, relay_stats = await hold_call({}, down=slow)
    rates = [watched.peer(name)["latents_per_s"] for name in PEERS]
    assert min(rates) >= 14  # the outbox is fair: nobody is starved
    assert max(rates) <= 20
    # A message holds what the line takes in a tenth of a second, and few are on their way.
    assert max(watched.delay_percentile(name, 99) for name in PEERS) <= 0.4
    assert sum(relay_stats["dropped"].values()) > 0
    assert relay_stats["open_connections"] == 0
