"""Layered streams through the whole relay: with literal times first, then on the virtual clock."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from pica_protocol.client_session import ClientSession
from pica_protocol.frames import Frame
from pica_protocol.messages import KeyframeRequest, PeerJoined, Track, Want
from pica_protocol.session import Closed, State
from pica_server.config.relay import RelayConfig
from pica_server.relay import Relay
from pica_server.room.hub import Hub
from simnet.clock import current_network, in_virtual_time
from simnet.layered import DYADIC, KEYFRAME, LayeredReader, LayeredWriter
from simnet.link import Link
from simnet.peers import FACE, WirePeer, now, peer_in_room

pytestmark = pytest.mark.call

URL = "ws://relay:8765"
FPS = 30.0


class Publisher:
    """Sends a layered stream; keyframes only first and when asked."""

    def __init__(self, peer: WirePeer, num_bytes: int = 30) -> None:
        self.peer = peer
        self.writer = LayeredWriter()
        self.num_keyframes = 0
        self._num_bytes = num_bytes
        self._answered = 0

    async def run(self, seconds: float) -> None:
        """Send for a while at ``FPS``."""
        start = now()
        for i in range(round(seconds * FPS)):
            await asyncio.sleep(start + i / FPS - now())
            if self.peer.session.state is not State.JOINED:
                return
            await self.send(DYADIC[i % len(DYADIC)])

    async def send(self, layer: int) -> None:
        """Send the next frame; a keyframe instead if one is due and this is a base frame."""
        asked = len(self.peer.told(KeyframeRequest))
        kind = layer
        if layer == 0 and (self.num_keyframes == 0 or asked > self._answered):
            kind, self._answered = KEYFRAME, asked
            self.num_keyframes += 1
        payload = self.writer.payload(kind, self._num_bytes)
        events = self.peer.session.send_frame(
            payload, round(now() * 1e6), layer=layer, is_keyframe=kind == KEYFRAME
        )
        assert not events  # our own way to the relay is free
        await self.peer.flush()


@asynccontextmanager
async def publishing(seconds: float, **options: int) -> AsyncIterator[Publisher]:
    """A room with a publisher in it that sends."""
    async with peer_in_room(URL, "Ada") as ada:
        publisher = Publisher(ada, **options)
        running = asyncio.create_task(publisher.run(seconds))
        try:
            yield publisher
            await running
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)


def decoded(peer: WirePeer) -> list[int]:
    """Return the kinds of all frames a peer got; every one must be decodable."""
    reader = LayeredReader()
    return [reader.read(frame) for _, frame in peer.arrivals]


@in_virtual_time
async def test_a_reader_that_keeps_up_gets_every_layer() -> None:
    async with (
        Relay(RelayConfig()) as relay,
        peer_in_room(URL, "Bob", tracks=()) as bob,
        publishing(seconds=10),
    ):
        await asyncio.sleep(10)
        assert len(decoded(bob)) == 300
        assert relay.stats()["dropped"] == {}


@in_virtual_time
async def test_a_latecomer_sees_a_face_at_once_and_disturbs_nobody() -> None:
    delay_s = 0.040
    current_network().route("far", up=Link(delay_s=delay_s), down=Link(delay_s=delay_s))
    async with Relay(RelayConfig()), publishing(seconds=4) as ada:
        await asyncio.sleep(3)
        start = now()
        async with peer_in_room("ws://far:8765", "Late", tracks=()) as late:
            await late.until(Frame)
            # TCP, websocket, join: three round trips; the face comes with the answer.
            assert now() - start == pytest.approx(3 * 2 * delay_s, abs=0.001)
            await asyncio.sleep(0.5)
            kinds = decoded(late)
            assert kinds[0] == KEYFRAME
            assert {0, 1, 2} <= set(kinds)
        assert ada.peer.told(KeyframeRequest) == []


@in_virtual_time
async def test_many_latecomers_to_a_long_chain_cost_one_keyframe_together() -> None:
    delay_s = 0.040
    for name in ("far", "relay"):
        current_network().route(name, up=Link(delay_s=delay_s), down=Link(delay_s=delay_s))
    async with Relay(RelayConfig()) as relay, publishing(seconds=17) as ada:
        await asyncio.sleep(15)  # 112 base frames
        start = now()
        async with asyncio.TaskGroup() as guests:
            for i in range(10):
                guests.create_task(check_late_guest(f"Guest {i}", start, delay_s))
        assert ada.num_keyframes == 2
        requests = relay.stats()["keyframe_requests"]
        assert requests["keyless"] == 1
        assert requests["withheld"] >= 9  # asked again with each base frame until it came


async def check_late_guest(name: str, start: float, delay_s: float) -> None:
    async with peer_in_room("ws://far:8765", name, tracks=()) as guest:
        await guest.until(Frame)
        joined_s = now()
        assert joined_s - start == pytest.approx(3 * 2 * delay_s, abs=0.001)
        await asyncio.sleep(0.5)
        assert decoded(guest)[:2] == [KEYFRAME, KEYFRAME]  # one to look at, one to go on from
        # One round trip from the relay to the publisher and on to us, and one base interval.
        assert guest.arrivals[1][0] - joined_s < 2 * delay_s + 4 / FPS + 0.001


@in_virtual_time
async def test_who_comes_back_after_a_drop_sees_the_face_at_once() -> None:
    async with Relay(RelayConfig()), publishing(seconds=4):
        await asyncio.sleep(1)
        async with peer_in_room(URL, "Bob", tracks=()) as bob:
            await asyncio.sleep(1)
            bob.websocket.transport.abort()
            await bob.until(Closed)
        async with peer_in_room(URL, "Bob", tracks=()) as bob:
            start = now()
            await bob.until(Frame)
            assert now() - start < 0.001
            await asyncio.sleep(1)
            assert {KEYFRAME, 0, 1, 2} == set(decoded(bob))


@in_virtual_time
async def test_a_publisher_that_comes_back_begins_a_new_stream_with_a_keyframe() -> None:
    async with Relay(RelayConfig()), peer_in_room(URL, "Bob", tracks=()) as bob:
        for _ in range(2):
            async with publishing(seconds=1) as ada:
                await asyncio.sleep(0.9)
                ada.peer.websocket.transport.abort()
                await ada.peer.until(Closed)
        streams = {frame.stream for _, frame in bob.arrivals}
        for stream in streams:
            reader = LayeredReader()
            for _, frame in bob.arrivals:
                if frame.stream == stream:
                    reader.read(frame)
        assert len(streams) == 2


@in_virtual_time
async def test_each_layer_can_be_dropped_and_taken_up_again_at_any_moment() -> None:
    async with (
        Relay(RelayConfig()),
        peer_in_room(URL, "Bob", tracks=()) as bob,
        publishing(seconds=26) as ada,
    ):
        stream = ada.peer.session.tracks[0].stream
        rates = {}
        for step, layer in enumerate((2, 1, 0, 2, None, 2, 0, 1, None, 0, 2)):
            bob.session.tell(Want(stream=stream, layer=layer))
            await bob.flush()
            before = len(bob.arrivals)
            await asyncio.sleep(2 + step / 90)  # at every place of the pattern
            rates.setdefault(layer, (len(bob.arrivals) - before) / (2 + step / 90))
            if layer is not None:
                assert bob.arrivals[-1][1].layer <= layer
        decoded(bob)
        expected = {2: 30, 1: 15, 0: 7.5, None: 0}
        assert {layer: pytest.approx(rate, abs=1) for layer, rate in expected.items()} == rates


@in_virtual_time
async def test_a_slow_reader_of_a_layered_stream_gets_fewer_frames_that_it_can_decode() -> None:
    network = current_network()
    network.route("modem", down=Link(rate_bps=8_000, window_bytes=2048))
    config = RelayConfig(slow_keyframe_interval_s=2.0)
    async with (
        Relay(config) as relay,
        peer_in_room(URL, "Fast", tracks=()) as fast,
        peer_in_room("ws://modem:8765", "Slow", tracks=()) as slow,
        publishing(seconds=60, num_bytes=40) as ada,  # 13.4 kbit/s with headers
    ):
        await asyncio.sleep(60)
        assert len(fast.arrivals) == 1800
        assert max(fast.delays_s) < 0.001
        kinds = decoded(slow)
        assert 300 < len(kinds) < 1200
        assert kinds.count(0) > kinds.count(2)
        assert ada.num_keyframes <= 1 + 60 / 2
        dropped = relay.stats()["dropped"]
        assert dropped["upper_replaced"] > dropped.get("base_cut", 0)


class Member:
    """A member with a layered stream and a reader for each stream that it gets."""

    def __init__(self, hub: Hub, name: str, at: float, tracks: tuple[Track, ...]) -> None:
        self.hub = hub
        self.connection = hub.connect(at)
        self.session = ClientSession(room="lobby", name=name, tracks=tracks, now=at)
        self.writer = LayeredWriter()
        self.readers: dict[int, LayeredReader] = {}
        self.asked_s = -1.0
        self.wishes: dict[int, int | None] = {}
        self.speak(at)

    @property
    def stream(self) -> int:
        return self.session.tracks[0].stream

    def speak(self, at: float) -> None:
        for data in self.session.messages_to_send(at):
            self.hub.receive(self.connection, data, at)

    def send(self, kind: int, at: float) -> None:
        payload = self.writer.payload(kind, 40)
        self.session.send_frame(payload, 0, layer=max(kind, 0), is_keyframe=kind == KEYFRAME)
        self.speak(at)

    def listen(self, at: float, max_messages: int = 1000) -> None:
        for _ in range(max_messages):
            message = self.hub.take(self.connection, at)
            if message is None:
                return
            self.hub.sent(self.connection, message, at)
            for event in self.session.receive_data(message.data, at):
                if isinstance(event, Frame):
                    self.readers.setdefault(event.stream, LayeredReader()).read(event)
                elif isinstance(event, KeyframeRequest):
                    self.asked_s = at
                elif isinstance(event, PeerJoined):
                    for track in event.peer.tracks:
                        self.wishes.setdefault(track.stream, 7)


class RelayMachine(RuleBasedStateMachine):
    """People who come, go, send, stall and change their wishes: what anybody gets can be decoded,
    and who cannot go on without a keyframe is not forgotten."""

    def __init__(self) -> None:
        super().__init__()
        self.hub = Hub(RelayConfig(room_capacity=4))
        self.at = 0.0
        self.num_joins = 0
        self.members: list[Member] = []

    @precondition(lambda self: len(self.members) < 4)
    @rule(publishes=st.booleans())
    def join(self, publishes: bool) -> None:
        self.num_joins += 1
        member = Member(self.hub, f"m{self.num_joins}", self.at, (FACE,) * publishes)
        member.listen(self.at, max_messages=2)  # Welcome and Joined; the faces may wait
        self.members.append(member)
        if publishes:
            member.send(KEYFRAME, self.at)

    @precondition(lambda self: self.members)
    @rule(index=st.integers(0, 3))
    def leave(self, index: int) -> None:
        member = self.members.pop(index % len(self.members))
        self.hub.disconnect(member.connection, 1006, "", self.at)

    @precondition(lambda self: self.members)
    @rule(
        index=st.integers(0, 3),
        kinds=st.lists(st.sampled_from([KEYFRAME, 0, 0, 0, 0, 1, 1, 2, 2]), max_size=20),
    )
    def send(self, index: int, kinds: list[int]) -> None:
        member = self.members[index % len(self.members)]
        for kind in kinds if member.session.tracks else []:
            member.send(kind, self.at)

    @precondition(lambda self: self.members)
    @rule(index=st.integers(0, 3), max_messages=st.sampled_from([1, 1000]))
    def listen(self, index: int, max_messages: int) -> None:
        self.members[index % len(self.members)].listen(self.at, max_messages)

    @precondition(lambda self: len(self.members) > 1)
    @rule(
        index=st.integers(0, 3),
        other=st.integers(0, 3),
        layer=st.sampled_from([None, 0, 1, 2]),
    )
    def want(self, index: int, other: int, layer: int | None) -> None:
        member = self.members[index % len(self.members)]
        publisher = self.members[other % len(self.members)]
        if publisher.session.tracks and publisher is not member:
            member.session.tell(Want(stream=publisher.stream, layer=layer))
            member.wishes[publisher.stream] = layer
            member.speak(self.at)

    @rule(seconds=st.sampled_from([0.033, 0.3, 5.0]))
    def wait(self, seconds: float) -> None:
        self.at += seconds

    def teardown(self) -> None:
        """With everybody reading, publishers that answer requests heal every stream."""
        for _ in range(4):
            self.at += 3.0
            for member in self.members:
                member.asked_s = -1.0
            for member in self.members:
                if member.session.tracks:
                    member.send(0, self.at)
            for member in self.members:
                member.listen(self.at)
            for member in self.members:
                if member.asked_s == self.at:
                    member.send(KEYFRAME, self.at)
            for member in self.members:
                member.listen(self.at)
        for member in self.members:
            for publisher in self.members:
                if publisher is member or not publisher.session.tracks:
                    continue
                if member.wishes.get(publisher.stream, 7) is not None:
                    assert member.readers[publisher.stream].newest == publisher.writer.newest


RelayMachine.TestCase.settings = settings(max_examples=100, stateful_step_count=30, deadline=None)
TestRelayMachine = RelayMachine.TestCase
