"""A NATS that comes late, or comes back without what it kept: relays wait, and make it again.

What is counted is asserted; times are printed (run with ``-s``), since they are the machine's.
"""

import asyncio
import os
import shutil
from pathlib import Path

import nats
import pytest

from simnet.cluster import Node, person, running_nodes, start_relay, until
from simnet.nats_server import NatsServer, needs_nats

pytestmark = [pytest.mark.realtime, needs_nats]

if os.name == "nt":
    pytest.skip("stops relays with Unix signals", allow_module_level=True)


@pytest.mark.parametrize("taken", ["all", "rooms"])
def test_a_nats_that_loses_its_store_is_given_a_new_one(tmp_path: Path, taken: str) -> None:
    """It comes back empty; or somebody removes the records while it runs.

    Where NATS ends by itself, what watches over services starts it again.
    """
    server = NatsServer(tmp_path / "store")
    server.start()

    async def lose_store() -> None:
        if taken == "all":
            server.stop()
            shutil.rmtree(tmp_path / "store")
            await asyncio.to_thread(server.start)
            return
        client = await nats.connect(server.url)
        await client.jetstream().delete_stream("KV_pica_rooms")
        await client.close()

    async def watch_over_nats() -> None:
        while True:
            await asyncio.sleep(0.1)
            if await asyncio.to_thread(server.restart_if_ended):
                print("\n    measured: nats-server ended by itself, and was started again")

    async def call(nodes: list[Node]) -> None:
        async with (
            person("ada", nodes[0], talks=True) as ada,
            person("bob", nodes[1], talks=True) as bob,
        ):
            await until(lambda: ada.sees("bob") and bob.sees("ada"))
            await lose_store()
            watch = asyncio.create_task(watch_over_nats())
            lost_s = asyncio.get_running_loop().time()
            async with person("cleo", nodes[1]) as cleo:
                await until(lambda: cleo.sees("ada", "bob") and ada.sees("bob", "cleo"))
                took_s = asyncio.get_running_loop().time() - lost_s
                print(f"\n    measured: somebody new is seen everywhere {took_s:.1f} s later")
            count = len(bob.frames)
            await until(lambda: ada.sees("bob") and len(bob.frames) > count + 20)
            assert ada.link.reconnects == bob.link.reconnects == 0
            assert ada.undecodable() == bob.undecodable() == 0
            for node in nodes:
                assert await asyncio.to_thread(node.page, "/readyz") == "ok\n"
            watch.cancel()

    try:
        with running_nodes(2, server.url) as nodes:
            asyncio.run(call(nodes))
    finally:
        server.stop()


def test_a_relay_waits_for_a_nats_that_is_not_there_yet(tmp_path: Path) -> None:
    server = NatsServer(tmp_path)
    process = start_relay("--port", "0", "--cluster", server.url.replace("//", "//user:secret@"))
    try:
        assert process.stderr is not None
        said = process.stderr.readline()
        assert "start `nats-server -js` there" in said
        assert "; waiting for it" in said
        assert "secret" not in said
        server.start()
        assert process.stderr.readline().startswith("listening on ")
    finally:
        process.terminate()
        process.communicate(timeout=30)
        server.stop()
    assert process.returncode == 0


def test_a_relay_that_waits_for_its_nats_stops_in_good_order() -> None:
    process = start_relay("--port", "0", "--cluster", "nats://127.0.0.1:1", "--json")
    assert process.stderr is not None
    process.stderr.readline()
    process.terminate()
    said, _ = process.communicate(timeout=30)
    assert process.returncode == 0
    assert '"open_connections": 0' in said
