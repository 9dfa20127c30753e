"""A receiver as a program of its own holds it: its beginning, its end, and what fails beside it."""

import asyncio
import queue
import threading
import time

import pytest

from helpers.senders import LoadedAvatars
from helpers.toy import make_toy_avatar
from pica_client.call.call import Call
from pica_client.call.status import CallStatus
from pica_client.endpoint import Receiver
from pica_client.publish import Outgoing, Publisher, SenderConfig
from pica_client.sources.source import Unseen
from pica_client.transport.connect import LinkConfig
from pica_client.transport.link import Link
from pica_core.avatar.arkit import ExpressionFrame
from pica_protocol.messages import FromMember, Subscribe, Track
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from simnet.clock import in_virtual_time
from simnet.peers import FACE, peer_in_room

pytestmark = pytest.mark.call

PATIENCE_S = 20.0


class Breaking(Unseen):
    """A face that breaks at its third frame."""

    num_frames = 0

    def frame_at(self, time_s: float) -> ExpressionFrame:
        self.num_frames += 1
        if self.num_frames > 2:
            raise ArithmeticError("the tracker broke")
        return super().frame_at(time_s)


def make_receiver(url: str, publisher: Publisher | None = None) -> Receiver:
    return Receiver(
        LinkConfig(url=url, name="me"), Call(LoadedAvatars({})), Outgoing(face=publisher)
    )


@pytest.mark.asyncio
async def test_a_source_that_fails_ends_the_call_and_is_closed() -> None:
    source = Breaking()
    publisher = Publisher(SenderConfig(), source, make_toy_avatar(), "0" * 64)
    async with asyncio.timeout(PATIENCE_S), Relay(RelayConfig(port=0)) as relay:
        with pytest.raises(ArithmeticError, match="the tracker broke"):
            await make_receiver(relay.url, publisher).run()
    assert publisher.source is not source  # it let go of it


@pytest.mark.asyncio
async def test_who_is_told_to_stop_before_it_runs_does_not_begin() -> None:
    receiver = make_receiver("ws://127.0.0.1:9")
    running = asyncio.create_task(receiver.run())
    receiver.stop()
    async with asyncio.timeout(PATIENCE_S):
        await running


@pytest.mark.asyncio
async def test_what_the_drawing_thread_wants_is_told_by_the_networks_thread() -> None:
    told: queue.Queue[tuple[str, int]] = queue.Queue()

    def tell(message: FromMember) -> bool:
        assert isinstance(message, Subscribe)
        told.put((threading.current_thread().name, message.every))
        return True

    async with asyncio.timeout(PATIENCE_S), Relay(RelayConfig(port=0)) as relay:
        bob = Link(LinkConfig(url=relay.url, name="Bob"), (FACE,))
        talking = asyncio.create_task(bob.run())
        receiver = make_receiver(relay.url)
        receiver.link.tell = tell  # type: ignore[method-assign]
        with receiver:
            while not (faces := receiver.call.faces(0.0)):  # noqa: ASYNC110
                await asyncio.sleep(0.02)
            (peer_id,) = (face.peer_id for face in faces)
            for every in (4, 1):  # nothing else wakes the network's thread
                receiver.call.subscribe(peer_id, every, time.monotonic())
                found = await asyncio.to_thread(told.get, timeout=PATIENCE_S)
                assert found == ("receiver", every)
        bob.leave()
        await talking


def test_a_machine_too_busy_to_take_frames_as_they_come_blames_no_connection() -> None:
    receiver = make_receiver("ws://127.0.0.1:9")
    busy = []

    def room(now: float, *, is_busy: bool = False) -> CallStatus:
        busy.append(is_busy)
        return CallStatus()

    receiver.call.room = room  # type: ignore[method-assign]
    for second, late_s in enumerate((0.0, 0.02, 0.04, 0.34, 0.36)):
        receiver.late_s = late_s
        receiver.status(float(second))
    assert busy == [False, False, False, True, False]


@in_virtual_time
async def test_tracks_of_unknown_kinds_and_second_faces_are_declined() -> None:
    tracks = (FACE, FACE, Track(kind="pointer"))
    async with Relay(RelayConfig()), peer_in_room("ws://relay:8765", "Bob", tracks=tracks) as bob:
        receiver = make_receiver("ws://relay:8765")
        running = asyncio.create_task(receiver.run())
        received = []
        for track in (1, 2, 0):
            await asyncio.sleep(1.0)
            await bob.send_frame(b"payload", track=track)
            await asyncio.sleep(0.1)
            received.append(receiver.link.received_messages)
        receiver.stop()
        await running
    assert received[0] == received[1] == received[2] - 1
