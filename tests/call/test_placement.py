"""Rooms on three relays with a real NATS server: placed, redirected, killed, drained, without NATS.

What is counted is asserted; times are printed (run with ``-s``), since they are the machine's.
"""

import asyncio
import os
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from simnet.relays import (
    NatsServer,
    Person,
    RelayProcess,
    needs_nats,
    person,
    running_relays,
    start_relay,
    until,
)

pytestmark = [pytest.mark.realtime, needs_nats]

if os.name == "nt":
    pytest.skip("stops relays with Unix signals", allow_module_level=True)

NUM_ROOMS = 30


@pytest.fixture
def nats(tmp_path: Path) -> Iterator[NatsServer]:
    server = NatsServer(tmp_path)
    server.start()
    yield server
    server.stop()


@pytest.fixture
def relays(nats: NatsServer) -> Iterator[list[RelayProcess]]:
    with running_relays(3, nats.url) as running:
        yield running


def report(text: str) -> None:
    print(f"\n    measured: {text}")


async def until_number(relay: RelayProcess, name: str, value: float) -> None:
    for _ in range(1000):
        if await asyncio.to_thread(relay.number, name) == value:
            return
        await asyncio.sleep(0.05)
    raise AssertionError(f"{name} does not become {value}")


async def total(relays: list[RelayProcess], name: str) -> float:
    return sum([await asyncio.to_thread(relay.number, name) for relay in relays])


async def pairs(
    stack: AsyncExitStack, relays: list[RelayProcess], num_rooms: int
) -> list[tuple[Person, Person]]:
    """Two people in each room, who ask different relays for it."""

    async def pair(number: int) -> tuple[Person, Person]:
        ada, ben = [
            await stack.enter_async_context(
                person(f"{name}{number}", relays[(number + turn) % len(relays)], f"room{number}")
            )
            for turn, name in enumerate(("ada", "ben"))
        ]
        return ada, ben

    made = [await pair(number) for number in range(num_rooms)]
    await until(lambda: all(map(are_together, made)))
    return made


def are_together(pair: tuple[Person, Person]) -> bool:
    ada, ben = pair
    is_at_one = ada.link.url == ben.link.url
    return is_at_one and ada.sees(ben.name) and ben.sees(ada.name)


@pytest.mark.asyncio
async def test_rooms_are_on_all_relays_and_back_within_five_seconds_when_one_is_killed(
    relays: list[RelayProcess],
) -> None:
    async with AsyncExitStack() as stack:
        made = await pairs(stack, relays[1:], NUM_ROOMS)
        num_rooms = [await asyncio.to_thread(each.number, "rooms") for each in relays]
        assert sum(num_rooms) == NUM_ROOMS
        assert min(num_rooms) >= 1  # a relay knows the load of others 0.4 s late
        hit = [pair for pair in made if pair[0].link.url == relays[0].url]
        assert hit
        killed_s = time.monotonic()
        relays[0].kill()
        await until(lambda: all(are_together(p) and p[0].link.url != relays[0].url for p in made))
        report(f"{len(hit)} rooms back {time.monotonic() - killed_s:.2f} s after the kill")
        assert not any(p.link.reconnects for pair in made if pair not in hit for p in pair)


@pytest.mark.asyncio
async def test_no_call_ends_when_nats_is_killed_and_comes_back_empty(
    relays: list[RelayProcess], tmp_path: Path, nats: NatsServer
) -> None:
    async with AsyncExitStack() as stack:
        made = await pairs(stack, relays, NUM_ROOMS)
        nats.stop()
        nats.empty()
        await asyncio.sleep(3.0)
        page = await asyncio.to_thread(relays[0].page, "/healthz")
        assert page == "ok\nNATS lost, new rooms are local\n"
        news = await stack.enter_async_context(person("new", relays[0], room="made-without"))
        assert news.has_joined
        assert await total(relays, 'placement_total{event="local"}') == 1
        await asyncio.to_thread(nats.start)
        back_s = time.monotonic()
        for each in relays:
            await until_number(each, "nats_lost", 0)
        report(f"all relays place rooms {time.monotonic() - back_s:.2f} s after NATS is back")
        await asyncio.sleep(1.0)
        assert all(map(are_together, made))
        everybody = [news, *(p for pair in made for p in pair)]
        assert not any(p.link.reconnects for p in everybody)
        for number, pair in enumerate(made[:6]):
            cleo = person("cleo", relays[number % 3], f"room{number}")
            async with cleo as late:
                await until(lambda late=late, pair=pair: late.sees(*(p.name for p in pair)))


@pytest.mark.parametrize(
    ("url", "complaint"),
    [
        ("http://127.0.0.1:4222", "--cluster is no address of NATS: write nats://HOST:4222"),
        ("PLAIN", "start nats-server with -js"),
    ],
)
def test_a_cluster_that_cannot_be_joined_ends_in_one_line_without_the_password(
    url: str, complaint: str, tmp_path: Path
) -> None:
    plain = NatsServer(tmp_path, jetstream=False)
    plain.start()
    secret = plain.url.replace("//", "//user:secret@")
    try:
        process = start_relay("--port", "0", "--cluster", secret if url == "PLAIN" else url)
        _, stderr = process.communicate(timeout=30)
    finally:
        plain.stop()
    assert process.returncode == 2, stderr
    (line,) = stderr.splitlines()
    assert complaint in line
    assert "secret" not in line
