"""Whole calls whose connections break: who comes back, with what, and what the others see."""

import asyncio
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import pytest

from helpers.senders import LoadedAvatars, make_senders
from helpers.toy import make_toy_avatar
from pica_client.call.call import Call
from pica_client.call.status import FaceState
from pica_client.endpoint import Receiver, Sender
from pica_client.publish import Outgoing, Publisher, SenderConfig
from pica_client.sources import open_source
from pica_client.transport.connect import LinkConfig
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from simnet.clock import current_network, in_virtual_time
from simnet.network import Network

pytestmark = pytest.mark.call

AVATARS = {"1" * 64: make_toy_avatar(seed=1)}
RELAY = RelayConfig(port=8765, ping_interval_s=2, close_timeout_s=1)


def config(name: str) -> LinkConfig:
    return LinkConfig(url=f"ws://{name}:8765", room="kitchen", name=name)


class Display:
    """What was seen of the only sender, a hundred times a second."""

    def __init__(self) -> None:
        self.seen: list[tuple[float, FaceState]] = []

    @property
    def peer_ids(self) -> set[str]:
        return {face.peer_id for _, face in self.seen}

    def statuses(self, begin_s: float, end_s: float) -> set[str]:
        return {face.status for at_s, face in self.seen if begin_s <= at_s < end_s}

    def notes(self, begin_s: float, end_s: float) -> set[str]:
        return {face.note for at_s, face in self.seen if begin_s <= at_s < end_s}


async def break_calls(
    broken: str, *, how: Callable[[Network, str], None] = Network.reset
) -> tuple[Display, dict[str, object], dict[str, object], dict[str, object]]:
    """A sender and a receiver; the connection of one of them breaks at 8 s."""
    loop, display = asyncio.get_running_loop(), Display()
    async with Relay(RELAY) as relay, asyncio.TaskGroup() as tasks:
        (sender,) = make_senders(
            [config("ada")], list(AVATARS.items()), config=SenderConfig(seconds=20.0)
        )
        receiver = Receiver(config("viewer"), Call(LoadedAvatars(AVATARS)))
        sending = tasks.create_task(sender.run())
        tasks.create_task(receiver.run())
        loop.call_at(8.0, how, current_network(), broken)
        while not sending.done():
            await asyncio.sleep(0.01)
            now = loop.time()
            display.seen += [(now, face) for face in receiver.call.faces(now)]
        found = sender.stats(), receiver.stats(loop.time()), relay.stats()
        receiver.stop()
    return display, *found


@in_virtual_time
async def test_a_sender_without_a_window_says_when_it_is_in_and_when_the_relay_went() -> None:
    said: list[str] = []
    avatar_id, avatar = next(iter(AVATARS.items()))
    link = replace(config("ada"), connect_timeout_s=None)
    source = open_source("performance:talk")
    sender = Sender(
        link, Outgoing(face=Publisher(SenderConfig(), source, avatar, avatar_id)), say=said.append
    )
    sending = asyncio.create_task(sender.run())
    await asyncio.sleep(3)
    assert said == []  # there is no relay yet
    for num_lines in (1, 3):
        async with Relay(RELAY):
            await asyncio.sleep(10)
            assert len(said) == num_lines
        await asyncio.sleep(2)
    sender.stop()
    await sending
    assert said[:2] == [
        "in room kitchen at ws://ada:8765 as ada",
        "connection to the relay lost (the relay is stopping); coming back by itself",
    ]
    assert re.fullmatch(r"back in the room after \d\.\d s", said[2])
    assert len(said) == 4  # lost once more; leaving is no news


@pytest.mark.parametrize("broken", ["ada", "viewer"])
@in_virtual_time
async def test_who_comes_back_has_its_old_place_and_all_goes_on_within_a_second(
    broken: str,
) -> None:
    display, sent, received, stats = await break_calls(broken)
    back = sent if broken == "ada" else received
    assert (back["reconnects"], back["resumes"]) == (1, 1)
    assert len(display.peer_ids) == 1
    assert stats["resumes"] == {"away": 1, "resumed": 1}
    assert ("connection lost" in display.notes(8.0, 9.0)) == (broken == "ada")
    assert display.statuses(9.0, 19.0) == {"live"}
    assert display.notes(9.0, 19.0) == {""}


@in_virtual_time
async def test_a_face_whose_sender_is_away_is_concealed_then_stale_then_live_in_its_seat() -> None:
    display, sent, _, _ = await break_calls("ada", how=partial(Network.reset, down_s=5.0))
    assert sent["resumes"] == 1
    assert len(display.peer_ids) == 1
    assert display.statuses(8.1, 9.5) == {"concealed"}
    assert display.statuses(10.5, 12.9) == {"stale"}
    assert display.statuses(18.0, 19.0) == {"live"}


@pytest.mark.parametrize("broken", ["ada", "viewer"])
@in_virtual_time
async def test_a_way_that_died_without_a_word_costs_three_seconds(broken: str) -> None:
    display, sent, received, stats = await break_calls(broken, how=Network.forget)
    assert "concealed" in display.statuses(8.2, 8.7)
    assert display.statuses(11.0, 19.0) == {"live"}
    assert (sent if broken == "ada" else received)["resumes"] == 1
    assert stats["resumes"] == {"resumed": 1}
