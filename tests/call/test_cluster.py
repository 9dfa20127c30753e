"""Rooms on two and three relays with a real NATS server: across, killed, restarted, full, empty.

What is counted is asserted; times are printed (run with ``-s``), since they are the machine's.
"""

import asyncio
import os
from collections.abc import Iterator
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from simnet.cluster import Node, Person, person, running_nodes, start_relay, until
from simnet.nats_server import NatsServer, needs_nats

pytestmark = [pytest.mark.realtime, needs_nats]

if os.name == "nt":
    pytest.skip("stops relays with Unix signals", allow_module_level=True)

LEASE_S = 3.0


@pytest.fixture(scope="module")
def nats(tmp_path_factory: pytest.TempPathFactory) -> Iterator[NatsServer]:
    server = NatsServer(tmp_path_factory.mktemp("jetstream"))
    server.start()
    yield server
    server.stop()


@pytest.fixture(scope="module")
def shared_nodes(nats: NatsServer) -> Iterator[list[Node]]:
    """Three nodes for all tests that break none of them."""
    with running_nodes(3, nats.url, "--room-capacity", "5") as running:
        yield running


def report(text: str) -> None:
    print(f"\n    measured: {text}")


def gaps_ms(people: list[Person], since: float, until_s: float) -> str:
    """The longest time that anybody waited for a frame of anybody else."""
    gaps = [a.longest_gap_s(b.stream, since, until_s) for a in people for b in people if a is not b]
    return f"{max(gaps) * 1000:.0f} ms"


def now() -> float:
    return asyncio.get_running_loop().time()


async def until_number(node: Node, name: str, value: float) -> None:
    for _ in range(200):
        if await asyncio.to_thread(node.number, name) == value:
            return
        await asyncio.sleep(0.05)
    raise AssertionError(f"{name} does not become {value}")


def test_people_on_three_nodes_see_hear_and_answer_each_other(shared_nodes: list[Node]) -> None:
    async def call() -> None:
        async with AsyncExitStack() as stack:
            names = ("ada", "bob", "cleo")
            ada, bob, cleo = people = [
                await stack.enter_async_context(person(name, node, room="across", talks=True))
                for name, node in zip(names, shared_nodes, strict=True)
            ]
            for each in people:
                await until(lambda each=each: each.sees(*(set(names) - {each.name})))
            start = now()
            await asyncio.sleep(1.0)
            for each in people:
                streams = {frame.stream for _, frame in each.frames}
                assert streams == {other.stream for other in people if other is not each}
                assert each.undecodable() == 0
            report(f"longest gap in a quiet second {gaps_ms(people, start, now())}")
            delays = sorted(
                at - frame.captured_us / 1e6 for p in people for at, frame in p.frames if at > start
            )
            report(f"sender to receiver, median {delays[len(delays) // 2] * 1000:.1f} ms")
            ada.link.whisper(cleo.peer_id, b"psst")
            await until(lambda: len(cleo.whispers) == 1)
            assert cleo.whispers[0].peer_id == ada.peer_id
            before = bob.keyframe_requests
            cleo.link.request_keyframe(bob.stream)
            await until(lambda: bob.keyframe_requests == before + 1)
            assert len({p.stream for p in people}) == 3

    asyncio.run(call())


def test_frames_go_only_where_somebody_wants_them_and_once(shared_nodes: list[Node]) -> None:
    sent = 'cluster_total{event="frames_out"}'

    async def call() -> None:
        async with (
            person("ada", shared_nodes[0], room="wishes") as ada,
            person("bob", shared_nodes[1], room="wishes", publishes=False) as bob,
            person("ben", shared_nodes[1], room="wishes", publishes=False) as ben,
            person("eve", shared_nodes[2], room="other", publishes=False),
        ):
            await until(lambda: bob.sees("ada", "ben"))
            before = await asyncio.to_thread(shared_nodes[0].number, sent)
            ada.say(b"both", is_keyframe=True)
            await until(lambda: len(bob.frames) == len(ben.frames) == 1)
            assert await asyncio.to_thread(shared_nodes[0].number, sent) == before + 1
            for receiver in (bob, ben):
                receiver.link.want(ada.stream, None)
            await asyncio.sleep(0.2)
            ada.say(b"nobody", is_keyframe=True)
            await asyncio.sleep(0.2)
            assert await asyncio.to_thread(shared_nodes[0].number, sent) == before + 1
            bob.link.want(ada.stream, 0)
            await until(lambda: len(bob.frames) == 2)
            assert [frame.payload for _, frame in bob.frames] == [b"both", b"nobody"]
            assert len(ben.frames) == 1

    asyncio.run(call())


def test_who_joins_on_another_node_sees_a_face_of_one_who_says_nothing_now(
    shared_nodes: list[Node],
) -> None:
    async def call() -> None:
        async with person("ada", shared_nodes[0], room="late") as ada:
            for i in range(4):
                ada.say(b"%d" % i, is_keyframe=i == 0)
                await asyncio.sleep(0.03)
            for name, node in (
                ("bob", shared_nodes[1]),
                ("ben", shared_nodes[1]),
                ("cleo", shared_nodes[2]),
            ):
                async with person(name, node, room="late", publishes=False) as late:
                    took_s = await until(lambda late=late: len(late.frames) == 4)
                    report(f"kept frames came {took_s * 1000:.0f} ms after the place in the room")
                    assert [frame.payload for _, frame in late.frames] == [b"0", b"1", b"2", b"3"]
            assert ada.keyframe_requests == 0

    asyncio.run(call())


def test_of_many_who_join_at_once_on_three_nodes_exactly_as_many_get_in_as_may(
    shared_nodes: list[Node],
) -> None:
    async def call() -> None:
        async with AsyncExitStack() as stack:
            joining = [
                stack.enter_async_context(person(f"p{i}", shared_nodes[i % 3], room="full"))
                for i in range(21)
            ]
            people = await asyncio.gather(*joining)
            inside = [p for p in people if p.joined is not None]
            assert len(inside) == 5
            assert all("full" in str(p.error) for p in people if p.joined is None)
            assert len({p.stream for p in inside}) == 5
            for each in inside:
                await until(lambda each=each: each.sees(*(p.name for p in inside if p is not each)))

    asyncio.run(call())


def test_a_node_that_empties_its_part_of_a_room_leaves_the_rest_as_it_is(
    shared_nodes: list[Node],
) -> None:
    async def call() -> None:
        async with (
            person("ada", shared_nodes[0], room="shared", talks=True) as ada,
            person("bob", shared_nodes[1], room="shared", talks=True) as bob,
        ):
            for _ in range(3):
                async with person("cleo", shared_nodes[2], room="shared"):
                    await until(lambda: ada.sees("bob", "cleo") and bob.sees("ada", "cleo"))
                await until(lambda: ada.sees("bob") and bob.sees("ada"))
            start = now()
            await asyncio.sleep(0.5)
            report(f"longest gap {gaps_ms([ada, bob], start, now())}")
            assert ada.left == bob.left == ["cleo"] * 3
            assert ada.undecodable() == bob.undecodable() == 0
            assert ada.link.reconnects == bob.link.reconnects == 0
            async with person("dan", shared_nodes[2], room="shared") as dan:
                assert dan.sees("ada", "bob")

    asyncio.run(call())


def test_a_killed_node_costs_its_own_people_one_reconnect_and_nobody_else_anything(
    nats: NatsServer,
) -> None:
    async def call(nodes: list[Node]) -> None:
        async with (
            person("ada", nodes[0], room="killed", talks=True) as ada,
            person("bob", nodes[1], room="killed", talks=True) as bob,
            person("cleo", nodes[2], nodes[0], room="killed", talks=True) as cleo,
            person("dan", nodes[2], nodes[1], room="killed", talks=True) as dan,
        ):
            await until(lambda: all(len(p.others) == 3 for p in (ada, bob, cleo, dan)))
            ghosts = {cleo.peer_id, dan.peer_id}
            killed = now()
            nodes[2].kill()
            await until(lambda: {cleo.peer_id, dan.peer_id}.isdisjoint(ghosts))
            report(f"both came back {(now() - killed) * 1000:.0f} ms after the kill")
            await until(lambda: len(ada.left) == len(bob.left) == 2)
            gone_s = now() - killed
            report(f"their old selves left {gone_s:.1f} s after the kill")
            assert gone_s < LEASE_S + 2
            await asyncio.sleep(0.3)
            ended = now()
            report(f"longest gap between survivors {gaps_ms([ada, bob], killed, ended)}")
            assert (cleo.link.reconnects, dan.link.reconnects) == (1, 1)
            assert (ada.link.reconnects, bob.link.reconnects) == (0, 0)
            assert ada.undecodable() == bob.undecodable() == 0
            for each in (ada, bob, cleo, dan):
                others = {"ada", "bob", "cleo", "dan"} - {each.name}
                assert each.sees(*others), each.others

    with running_nodes(3, nats.url, "--room-capacity", "6") as nodes:
        asyncio.run(call(nodes))


def test_in_a_full_room_the_people_of_a_killed_node_get_their_places_back(
    nats: NatsServer,
) -> None:
    async def call(nodes: list[Node]) -> None:
        async with (
            person("ada", nodes[0], room="places") as ada,
            person("bob", nodes[1], nodes[0], room="places") as bob,
        ):
            await until(lambda: ada.sees("bob"))
            killed = now()
            nodes[1].kill()
            await until(lambda: ada.left == ["bob"] and ada.sees("bob"))
            report(f"back in a full room {now() - killed:.1f} s after the kill")
            assert bob.error is None
            assert bob.link.reconnects == 1

    with running_nodes(2, nats.url, "--room-capacity", "2") as nodes:
        asyncio.run(call(nodes))


def test_a_frozen_node_holds_up_nobody_and_comes_back_with_its_people(nats: NatsServer) -> None:
    async def call(nodes: list[Node]) -> None:
        async with (
            person("ada", nodes[0], room="frozen", talks=True) as ada,
            person("bob", nodes[1], room="frozen", talks=True) as bob,
            person("cleo", nodes[2], room="frozen", talks=True) as cleo,
        ):
            await until(lambda: all(len(p.others) == 2 for p in (ada, bob, cleo)))
            frozen = now()
            nodes[2].freeze()
            await until(lambda: ada.left == bob.left == ["cleo"])
            report(f"longest gap between survivors {gaps_ms([ada, bob], frozen, now())}")
            nodes[2].thaw()
            thawed = now()
            await until(lambda: ada.sees("bob", "cleo") and bob.sees("ada", "cleo"))
            num = len(cleo.frames)
            await until(lambda: len(cleo.frames) > num + 20)
            report(f"all together {now() - thawed:.1f} s after it went on")
            assert [p.link.reconnects for p in (ada, bob, cleo)] == [0, 0, 0]
            assert ada.undecodable() == bob.undecodable() == cleo.undecodable() == 0

    with running_nodes(3, nats.url) as nodes:
        asyncio.run(call(nodes))


def test_a_restart_of_nats_is_a_still_face_and_nobody_leaves(tmp_path: Path) -> None:
    server = NatsServer(tmp_path)
    server.start()

    async def call(nodes: list[Node]) -> None:
        async with (
            person("ada", nodes[0], talks=True) as ada,
            person("amy", nodes[0], talks=True) as amy,
            person("bob", nodes[1], talks=True) as bob,
        ):
            await until(lambda: all(len(p.others) == 2 for p in (ada, amy, bob)))
            await asyncio.sleep(0.3)
            stopped = now()
            server.stop()
            await asyncio.sleep(0.5)
            await asyncio.to_thread(server.start)
            started = now()
            count = len(bob.frames)
            await until(lambda: len(bob.frames) > count + 30)
            async with person("cleo", nodes[1]) as cleo:
                await until(
                    lambda: cleo.sees("ada", "amy", "bob") and ada.sees("amy", "bob", "cleo")
                )
            await until(lambda: all(p.left for p in (ada, amy, bob)))
            report(f"longest gap in one node {gaps_ms([ada, amy], stopped, now())}")
            report(
                f"longest gap across nodes {gaps_ms([ada, bob], stopped, now())}, "
                f"NATS was away for {(started - stopped) * 1000:.0f} ms"
            )
            assert ada.left == amy.left == bob.left == ["cleo"]
            assert [p.link.reconnects for p in (ada, amy, bob)] == [0, 0, 0]
            assert ada.undecodable() == amy.undecodable() == bob.undecodable() == 0

    try:
        with running_nodes(2, server.url) as nodes:
            asyncio.run(call(nodes))
    finally:
        server.stop()


def test_without_nats_rooms_are_local_and_say_so_and_what_was_split_heals_by_itself(
    tmp_path: Path,
) -> None:
    server = NatsServer(tmp_path)
    server.start()

    async def call(nodes: list[Node]) -> None:
        async with AsyncExitStack() as stack:
            ada, amy, bob = [
                await stack.enter_async_context(person(name, node, talks=True))
                for name, node in zip(("ada", "amy", "bob"), (nodes[0], *nodes), strict=True)
            ]
            await until(lambda: all(len(p.others) == 2 for p in (ada, amy, bob)))
            assert await asyncio.to_thread(nodes[0].page, "/healthz") == "ok\n"
            await until_number(nodes[0], "cluster_nodes", 2)
            stopped = now()
            server.stop()
            waits = asyncio.create_task(stack.enter_async_context(person("cleo", nodes[0])))
            await until(lambda: ada.sees("amy", "cleo") and bob.sees())
            report(f"local rooms {now() - stopped:.1f} s after NATS was gone")
            cleo = await waits
            dan = await stack.enter_async_context(person("dan", nodes[1]))
            page = await asyncio.to_thread(nodes[0].page, "/healthz")
            assert page == "ok\ncluster lost, rooms are local\n"
            assert await asyncio.to_thread(nodes[0].number, "cluster_up") == 0
            report(f"longest gap in one node {gaps_ms([ada, amy], stopped, now())}")
            await asyncio.to_thread(server.start)
            started = now()
            everybody = [ada, amy, bob, cleo, dan]
            names = {p.name for p in everybody}
            for each in everybody:
                await until(lambda each=each: each.sees(*(names - {each.name})))
            report(f"healed {now() - started:.1f} s after NATS was back")
            assert all(p.link.reconnects == 0 for p in everybody)
            assert len({p.stream for p in everybody}) == 5
            async with person("eve", nodes[1]) as eve:
                assert "full" in str(eve.error), (
                    "five are in a room for four, nobody was thrown out"
                )
            count = len(bob.frames)
            await until(lambda: len(bob.frames) > count + 20)
            assert ada.undecodable() == amy.undecodable() == bob.undecodable() == 0
            assert await asyncio.to_thread(nodes[0].page, "/healthz") == "ok\n"

    try:
        with running_nodes(2, server.url, "--room-capacity", "4") as nodes:
            asyncio.run(call(nodes))
    finally:
        server.stop()


def test_a_nats_that_takes_nothing_more_holds_up_no_room(tmp_path: Path) -> None:
    server = NatsServer(tmp_path)
    server.start()

    async def call(nodes: list[Node]) -> None:
        async with (
            person("ada", nodes[0], talks=True) as ada,
            person("amy", nodes[0], talks=True) as amy,
            person("bob", nodes[1], talks=True) as bob,
        ):
            await until(lambda: all(len(p.others) == 2 for p in (ada, amy, bob)))
            for each in (ada, amy, bob):
                each.payload_bytes = 1100
            frozen = now()
            server.freeze()
            await asyncio.sleep(4.0)
            report(f"longest gap in one node {gaps_ms([ada, amy], frozen, now())}")
            assert (ada.left, amy.left, sorted(bob.left)) == (["bob"], ["bob"], ["ada", "amy"])
            waiting = await asyncio.to_thread(nodes[0].number, "waiting_frames")
            assert waiting < 10
            server.thaw()
            thawed = now()
            await until(lambda: ada.sees("amy", "bob") and bob.sees("ada", "amy"))
            count = len(bob.frames)
            await until(lambda: len(bob.frames) > count + 20)
            report(f"together again {now() - thawed:.1f} s after it went on")
            assert [p.link.reconnects for p in (ada, amy, bob)] == [0, 0, 0]
            assert ada.undecodable() == amy.undecodable() == bob.undecodable() == 0

    try:
        with running_nodes(2, server.url) as nodes:
            asyncio.run(call(nodes))
    finally:
        server.thaw()
        server.stop()


def test_a_nats_that_refuses_its_nodes_for_a_while_gets_them_back(tmp_path: Path) -> None:
    server = NatsServer(tmp_path / "store", config=tmp_path / "nats.conf")
    server.start()

    async def call(nodes: list[Node]) -> None:
        async with (
            person("ada", nodes[0], talks=True) as ada,
            person("bob", nodes[1], talks=True) as bob,
        ):
            await until(lambda: ada.sees("bob") and bob.sees("ada"))
            server.ask_for_password("new")
            await until(lambda: ada.sees() and bob.sees())
            server.stop()
            server.let_everybody_in()
            await asyncio.to_thread(server.start)
            let_in = now()
            await until(lambda: ada.sees("bob") and bob.sees("ada"))
            count = len(ada.frames)
            await until(lambda: len(ada.frames) > count + 20)
            report(f"together again {now() - let_in:.1f} s after they were let in")
            assert ada.link.reconnects == bob.link.reconnects == 0
            assert ada.undecodable() == bob.undecodable() == 0

    try:
        with running_nodes(2, server.url) as nodes:
            asyncio.run(call(nodes))
    finally:
        server.stop()


def test_a_node_that_stops_in_good_order_takes_its_people_out_at_once(
    nats: NatsServer, shared_nodes: list[Node]
) -> None:
    async def call(nodes: list[Node]) -> None:
        async with (
            person("ada", nodes[0], room="order") as ada,
            person("bob", nodes[1], nodes[0], room="order") as bob,
        ):
            await until(lambda: ada.sees("bob"))
            before = len(shared_nodes) + len(nodes)
            await until_number(nodes[0], "cluster_nodes", before)
            nodes[1].process.terminate()
            took_s = await until(lambda: ada.left == ["bob"])
            report(f"gone {took_s * 1000:.0f} ms after SIGTERM")
            assert took_s < LEASE_S
            await until(lambda: ada.sees("bob"))
            assert bob.link.reconnects == 1
            await until(lambda: nodes[1].process.poll() is not None)
            assert nodes[1].process.returncode == 0
            await until_number(nodes[0], "cluster_nodes", before - 1)

    with running_nodes(2, nats.url) as nodes:
        asyncio.run(call(nodes))


def test_two_relays_of_one_machine_share_a_port_and_their_rooms(nats: NatsServer) -> None:
    async def call(nodes: list[Node]) -> None:
        async with AsyncExitStack() as stack:
            people = [
                await stack.enter_async_context(person(f"p{i}", nodes[0], room="port"))
                for i in range(8)
            ]
            for each in people:
                await until(lambda each=each: len(each.others) == 7)
            assert len({p.peer_id.partition("-")[0] for p in people}) <= 2

    with running_nodes(1, nats.url, "--share-port") as first:
        port = first[0].url.rpartition(":")[2]
        with running_nodes(1, nats.url, "--share-port", "--port", port) as second:
            asyncio.run(call([first[0], second[0]]))


@pytest.mark.parametrize(
    ("url", "complaint"),
    [
        ("http://127.0.0.1:4222", "--cluster is no address of NATS: write nats://HOST:4222"),
        ("PLAIN", "no JetStream"),
    ],
)
def test_a_cluster_that_cannot_be_joined_ends_in_one_line_without_the_password(
    url: str, complaint: str, tmp_path: Path
) -> None:
    plain = NatsServer(tmp_path, jetstream=False)
    plain.start()
    try:
        process = start_relay("--port", "0", "--cluster", plain.url if url == "PLAIN" else url)
        _, stderr = process.communicate(timeout=30)
    finally:
        plain.stop()
    assert process.returncode == 2, stderr
    (line,) = stderr.splitlines()
    assert complaint in line
    assert "secret" not in line
