"""Voices through the real relay, on the virtual clock: heard, muted, refused, sealed, replaced."""

import asyncio
from importlib import resources
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from helpers.senders import LoadedAvatars, link_of
from pica_client.call.call import Call, Ears
from pica_client.e2ee.secret import RoomSecret, save_secret
from pica_client.endpoint import Receiver
from pica_client.publish import Outgoing, Publisher, SenderConfig
from pica_client.sources import open_source
from pica_client.tracks import VOICE_KEY
from pica_client.voice import opus
from pica_client.voice.opus import FRAME_US
from pica_client.voice.source import TURN_S, SoundSource, VoicePublisher
from pica_core.avatar.file import load_avatar
from pica_protocol.frames import Frame
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from simnet.clock import current_network, in_virtual_time
from simnet.network import Wire

pytestmark = [
    pytest.mark.call,
    pytest.mark.skipif(opus.available() is not None, reason="needs libopus"),
]

AVATAR_ID = "5" * 64
AVATAR = load_avatar(Path(str(resources.files("pica_core"))) / "avatars" / "amara.pica")
SOUND = (
    np.random.default_rng(1).normal(0, 0.1, 48_000)
    * (0.6 + 0.4 * np.sin(np.arange(48_000) / 48_000 * 2 * np.pi * 4))
).astype(np.float32)


class Person(Ears):
    """Somebody in the call; ``heard`` is what came of each other one's voice."""

    def __init__(
        self,
        url: str,
        name: str,
        *,
        speaks: bool = False,
        turn: tuple[int, int] = (0, 1),
        is_seen: bool = False,
        face: str = "performance:talk",
        hears: bool = True,
        secret_file: Path | None = None,
    ) -> None:
        self.heard: dict[str, list[tuple[Frame, float]]] = {}
        self.publisher = self.voice = None
        if is_seen:
            source = open_source(face)
            self.publisher = Publisher(SenderConfig(), source, AVATAR, AVATAR_ID)
        if speaks:
            is_sealed = secret_file is not None
            self.voice = VoicePublisher(SoundSource(SOUND, *turn), is_sealed=is_sealed)
        self.receiver = Receiver(
            link_of(url, name, secret_file=secret_file),
            Call(LoadedAvatars({AVATAR_ID: AVATAR}), ears=self if hears else None),
            Outgoing(face=self.publisher, voice=self.voice),
        )

    def receive(self, peer_id: str, packet: Frame, arrived_s: float) -> None:
        self.heard.setdefault(peer_id, []).append((packet, arrived_s))

    @property
    def packets(self) -> list[Frame]:
        """What came of the one voice that was heard."""
        ((packets),) = self.heard.values()
        return [packet for packet, _ in packets]

    @property
    def seen(self) -> int:
        """Frames of faces that arrived."""
        return sum(peer["received"] for peer in self.receiver.call.stats(0.0)["peers"])


async def meet(people: list[Person], seconds: float) -> None:
    async with asyncio.TaskGroup() as tasks:
        for person in people:
            tasks.create_task(person.receiver.run())
        await asyncio.sleep(seconds)
        for person in people:
            person.receiver.stop()


@in_virtual_time
async def test_a_voice_alone_makes_a_face() -> None:
    async with Relay(RelayConfig(port=0)) as relay:
        ada = Person(relay.url, "ada", speaks=True, is_seen=True, face="voice")
        ben = Person(relay.url, "ben")
        assert ada.voice is not None
        meeting = asyncio.create_task(meet([ada, ben], 4.0))
        await asyncio.sleep(2.0)
        assert ben.seen > 30
        assert ada.publisher is not None
        assert ada.publisher.seen is not None
        assert not ada.publisher.seen.has_face  # there is no tracker; what was sent is the voice's
        await meeting


@in_virtual_time
async def test_a_voice_is_heard_beside_its_face_on_one_clock_and_by_no_one_who_wants_none() -> None:
    async with Relay(RelayConfig(port=0)) as relay:
        ada = Person(relay.url, "ada", speaks=True, is_seen=True)
        ben = Person(relay.url, "ben")
        cho = Person(relay.url, "cho", hears=False)
        await meet([ada, ben, cho], 4.0)

        sequences = [packet.sequence for packet in ben.packets]
        assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
        assert len(sequences) > 95
        times = np.diff([packet.captured_us for packet in ben.packets])
        assert set(times) == {2 * FRAME_US}
        assert ben.seen > 95
        assert cho.heard == {}
        assert cho.seen > 95


@in_virtual_time
async def test_a_mute_lets_the_frame_that_was_begun_out_and_says_so() -> None:
    async with Relay(RelayConfig(port=0)) as relay:
        ada, ben = Person(relay.url, "ada", speaks=True), Person(relay.url, "ben")
        assert ada.voice is not None
        meeting = asyncio.create_task(meet([ada, ben], 6.5))
        await asyncio.sleep(2.0)
        before = len(ben.packets)
        ada.voice.is_muted = True
        await asyncio.sleep(2.0)
        assert len(ben.packets) - before <= 2  # the one begun, and what the encoder held back
        (member,) = ben.receiver.call.room(4.0).participants
        assert dict(member.peer.metadata) == {VOICE_KEY: "muted"}
        muted = len(ben.packets)
        ada.voice.is_muted = False
        await asyncio.sleep(2.0)
        again = ben.packets[muted:]
        assert len(again) > 47
        assert again[0].sequence == ben.packets[muted - 1].sequence + 1  # a silence, no loss
        assert again[0].captured_us - ben.packets[muted - 1].captured_us > 1_900_000
        await meeting


@in_virtual_time
async def test_sealed_voices_and_faces_open_at_once_and_only_for_who_has_the_secret() -> None:
    loop, delays_s = asyncio.get_running_loop(), {"ada": 0.05, "dee": 0.08}
    for name, delay_s in delays_s.items():
        way = Wire(delay_s=delay_s)
        current_network().route(name, up=way, down=way)
    with TemporaryDirectory() as folder:
        secret_file = Path(folder) / "room.secret"
        save_secret(secret_file, RoomSecret.new())
        async with Relay(RelayConfig(port=0)) as relay, asyncio.TaskGroup() as tasks:
            ada = Person(relay.url, "ada", speaks=True, is_seen=True, secret_file=secret_file)
            ben, dee = (Person(relay.url, name, secret_file=secret_file) for name in ("ben", "dee"))
            eve = Person(relay.url, "eve")
            tasks.create_task(meet([ada, ben, eve], 6.0))
            await asyncio.sleep(2.0)
            tasks.create_task(meet([dee], 2.0))
            while not dee.receiver.link.is_joined:  # noqa: ASYNC110
                await asyncio.sleep(0.001)
            joined_s = loop.time()
            await asyncio.sleep(1.0)
            guards = [person.receiver.link.guard for person in (ada, ben, dee)]
            before = [guard.stats() for guard in guards if guard is not None]
    assert len(ben.packets) > 125
    assert ben.seen > 125
    assert len({len(packet.payload) for packet in ben.packets}) == 1  # sizes tell no words
    said = {packet.payload for packet in ben.packets}
    assert all(packet.payload not in said for packet, _ in eve.heard.get("p1", []))
    # Who comes later hears all from one round trip and one packet on, and nothing from before.
    ((first, arrived_s), *_) = next(iter(dee.heard.values()))
    assert first.captured_us / 1e6 > joined_s - 0.001
    assert arrived_s - joined_s <= 2 * sum(delays_s.values()) + 2 * FRAME_US / 1e6
    # Those who stay miss nothing when the keys change because a participant leaves.
    after = [guard.stats() for guard in guards if guard is not None]
    assert after[0]["key_changes"] == before[0]["key_changes"] + 1
    assert after[1]["unreadable"] == before[1]["unreadable"]
    assert after[1]["replayed"] == after[1]["forged"] == 0
    numbers = [packet.sequence for packet in ben.packets]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


@pytest.mark.parametrize("who", ["ada", "ben"])
@in_virtual_time
async def test_after_six_seconds_without_radio_a_voice_is_fresh_within_a_second(who: str) -> None:
    way = Wire(delay_s=0.03, queue_bytes=16_384)
    current_network().route(who, up=way, down=way)
    async with Relay(RelayConfig(port=0)) as relay:
        ada, ben = Person(relay.url, "ada", speaks=True), Person(relay.url, "ben")
        meeting = asyncio.create_task(meet([ada, ben], 20.0))
        await asyncio.sleep(5.0)
        current_network().stall(who, 6.0)
        await meeting
    ((voice),) = ben.heard.values()
    ages_s = [
        arrived_s - packet.captured_us / 1e6 for packet, arrived_s in voice if arrived_s > 12.0
    ]
    assert len(ages_s) > 7.5 * 25
    assert max(ages_s) < 0.15


@in_virtual_time
async def test_of_four_who_talk_in_turn_no_word_is_lost_over_64_kbit_s() -> None:
    async with Relay(RelayConfig(port=0)) as relay:
        down = Wire(delay_s=0.02, rate_bps=64_000, queue_bytes=1024)
        current_network().route("ben", down=down)
        ben = Person(relay.url, "ben")
        others = [
            Person(relay.url, name, speaks=True, turn=(index, 4), is_seen=True)
            for index, name in enumerate(("ada", "cho", "dan", "eve"))
        ]
        await meet([ben, *others], 4 * TURN_S + 4)
        delays_s = []
        for voice in ben.heard.values():
            packets = [packet for packet, _ in voice]
            for before, after in pairwise(packets):
                assert after.sequence == before.sequence + 1
            delays_s += [arrived_s - packet.captured_us / 1e6 for packet, arrived_s in voice]
        assert len(ben.heard) == 4
        assert np.percentile(delays_s, 95) < 0.2
        assert ben.seen > 400
