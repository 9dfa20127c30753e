"""What a relay does in each turn of its event loop, without a socket."""

import asyncio
from typing import TYPE_CHECKING, cast

import pytest

from pica_server.config.relay import RelayConfig
from pica_server.net.pump import Pump
from pica_server.room.hub import Hub

if TYPE_CHECKING:
    from pica_server.cluster.nats import Cluster

pytestmark = pytest.mark.unit


class CountingCluster:
    """Counts how often it is its turn."""

    def __init__(self) -> None:
        self.steps = 0

    def step(self) -> None:
        self.steps += 1


def test_a_cluster_that_asks_for_a_turn_gets_one_although_nobody_has_sent_anything() -> None:
    async def turns() -> None:
        config = RelayConfig()
        pump, cluster = Pump(Hub(config), config), CountingCluster()
        pump.cluster = cast("Cluster", cluster)
        pump.start()
        pump.after_turn_soon()
        pump.after_turn_soon()
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert cluster.steps == 1
        pump.stop()

    asyncio.run(turns())
