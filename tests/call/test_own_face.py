"""One's own face beside a call: over the same link, muted, and the others are told why.

On the virtual clock, through the real relay.
"""

import asyncio
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from helpers.senders import LoadedAvatars, link_of
from helpers.toy import make_toy_avatar
from pica_client.call.call import Call, Reflection
from pica_client.call.status import CallStatus, FaceState
from pica_client.endpoint import Receiver
from pica_client.publish import Outgoing, Publisher, SenderConfig
from pica_client.sources import open_source
from pica_client.tracks import FaceMode
from pica_core.avatar.arkit import ExpressionFrame
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from simnet.clock import current_network, in_virtual_time
from simnet.network import Wire

pytestmark = pytest.mark.call

AVATAR_ID = "5" * 64
AVATAR = make_toy_avatar()
MOVES = 0.01
"""Least `Person.motion` of a face that talks. The toy avatar's latents of performance:talk, 20 a
second, take largest steps of 0.011 to 0.110 in nineteen of twenty seconds, 0.026 in the median
(0.05 is beyond seven seconds of ten); a face that stands still takes none."""


class Still:
    """A face that does not move."""

    def __init__(self, face: ExpressionFrame) -> None:
        self._face = face

    def frame_at(self, time_s: float) -> ExpressionFrame:
        return replace(self._face, captured_us=round(time_s * 1e6))


class Person:
    """Somebody in the call, who looks at it twenty times a second."""

    def __init__(self, url: str, name: str, *, sends: bool = False) -> None:
        self.publisher = None
        if sends:
            source = open_source("performance:talk")
            self.publisher = Publisher(SenderConfig(), source, AVATAR, AVATAR_ID)
        self.receiver = Receiver(
            link_of(url, name),
            Call(LoadedAvatars({AVATAR_ID: AVATAR})),
            Outgoing(face=self.publisher),
        )
        self.seen: list[FaceState] = []
        self.status = CallStatus()

    async def look(self, seconds: float) -> None:
        loop = asyncio.get_running_loop()
        for index in range(round(seconds * 20)):
            await asyncio.sleep(0.05)
            self.seen += self.receiver.call.faces(loop.time())
            if index % 10 == 0:
                self.status = self.receiver.status(loop.time())

    def motion(self) -> float:
        """Largest step of a number of the latent over the last second."""
        latents = [face.latent for face in self.seen[-20:] if face.latent is not None]
        return max(
            (float(np.abs(after - before).max()) for before, after in pairwise(latents)),
            default=0.0,
        )


def set_mode(person: Person, mode: FaceMode) -> None:
    assert person.publisher is not None
    person.publisher.mode = mode


@in_virtual_time
async def test_a_face_is_sent_muted_and_let_go_on_over_the_link_of_the_call() -> None:
    async with Relay(RelayConfig(port=0)) as relay:
        ada, ben = Person(relay.url, "ada", sends=True), Person(relay.url, "ben")
        async with asyncio.TaskGroup() as tasks:
            for person in (ada, ben):
                tasks.create_task(person.receiver.run())
            await ben.look(4)
            assert [face.name for face in ben.seen[-1:]] == ["ada"]
            assert ben.motion() > MOVES
            assert ada.receiver.call.faces(4.0) == []  # nobody is sent their own face

            set_mode(ada, "muted")
            await ben.look(4)
            assert ben.seen[-1].status == "stale"
            assert ben.seen[-1].note == "face is off"
            assert ben.status.participants[1].quality != "poor"

            set_mode(ada, "sent")
            await ben.look(2)
            assert ben.seen[-1].status == "live"
            assert ben.seen[-1].note == ""
            assert ben.motion() > MOVES
            for person in (ada, ben):
                person.receiver.stop()
        sent = ada.receiver.stats(14.0)["sent"]
        assert sent["without_face"] > 80


@in_virtual_time
async def test_ones_own_face_is_what_the_others_see_and_not_what_the_tracker_saw() -> None:
    async with Relay(RelayConfig(port=0)) as relay:
        ada, ben = Person(relay.url, "ada", sends=True), Person(relay.url, "ben")
        assert ada.publisher is not None
        reflection = Reflection(AVATAR, ada.publisher.track)
        async with asyncio.TaskGroup() as tasks:
            for person in (ada, ben):
                tasks.create_task(person.receiver.run())
            await ben.look(3)
            ada.publisher.watch(reflection.receive)  # in the middle of a call
            await ben.look(2)
            face = open_source("performance:talk").frame_at(5.0)
            ada.publisher.replace_source(Still(face))  # two playout delays show one face
            await ben.look(3)
            (own,) = reflection.call.faces(asyncio.get_running_loop().time())
            assert own.latent is not None
            assert ben.seen[-1].latent is not None
            assert np.abs(own.latent - ben.seen[-1].latent).max() < 1e-5
            tracked = ExpressionEncoder(AVATAR).encode(face.arkit)
            assert np.abs(own.latent - tracked).max() > 1e-4
            set_mode(ada, "muted")
            await ben.look(3)
            (own,) = reflection.call.faces(asyncio.get_running_loop().time())
            assert own.status == "stale"
            for person in (ada, ben):
                person.receiver.stop()


@in_virtual_time
async def test_a_poor_connection_is_told_to_its_owner_and_where_the_face_stands_still() -> None:
    current_network().route("ada", up=Wire(delay_s=0.02, rate_bps=6_000, queue_bytes=300))
    current_network().route("cho", up=Wire(delay_s=0.02, rate_bps=6_000, queue_bytes=8_000))
    async with Relay(RelayConfig(port=0)) as relay:
        # Ada leaves frames out, and her others come in time; those of Cho wait in a long queue.
        ada, cho = (Person(relay.url, name, sends=True) for name in ("ada", "cho"))
        ben = Person(relay.url, "ben")
        people = (ada, ben, cho)
        async with asyncio.TaskGroup() as tasks:
            for person in people:
                tasks.create_task(person.receiver.run())
            await asyncio.gather(*(person.look(20) for person in people))
            assert ada.receiver.link.num_replaced > 20
            assert ada.status.own_quality == "poor"
            quality = {member.name: member.quality for member in ben.status.participants}
            assert (quality["ada"], quality["cho"]) == ("good", "poor")
            assert ben.status.is_connected
            for person in people:
                person.receiver.stop()
        await asyncio.sleep(0.1)
        before, after = ben.receiver.status(20.0), ben.receiver.status(23.0)
        assert not after.is_connected
        assert after.away_s - before.away_s == pytest.approx(3.0)


@in_virtual_time
async def test_who_comes_later_is_told_who_records_and_of_quick_changes_the_last() -> None:
    async with Relay(RelayConfig(port=0)) as relay:
        ben, cho = Person(relay.url, "ben"), Person(relay.url, "cho")
        ben.receiver.say_recording(True)  # as from a command line, before anything runs

        def recorders(now: float) -> list[str]:
            members = cho.receiver.call.room(now).participants
            return [member.name for member in members if member.is_recording]

        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(ben.receiver.run())
            await asyncio.sleep(2)
            tasks.create_task(cho.receiver.run())
            await asyncio.sleep(2)
            assert recorders(4.0) == ["ben"]
            for index in range(200):  # a key that is held down: the relay allows one a second
                ben.receiver.say_recording(index % 2 == 0)
                await asyncio.sleep(0.05)
            await asyncio.sleep(2)
            assert recorders(16.0) == []
            assert ben.receiver.link.reconnects == 0
            for person in (ben, cho):
                person.receiver.stop()
