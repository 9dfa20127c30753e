"""Coded streams through the real relay on the virtual clock: joining late, stalls, thinning, a new
relay.

Sender and receiver are the product's, with a shipped avatar; only their two ends of the stream are
watched, to compare each face that is shown with the one that was sent. Code takes no time on a
virtual clock: delays are those of the network and of our own waiting.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import numpy.typing as npt
import pytest

from helpers.senders import LoadedAvatars, make_senders
from pica_client.call import participant as participant_module
from pica_client.call.call import Call
from pica_client.call.faces import FaceState
from pica_client.endpoint.endpoint import Receiver, Sender
from pica_client.publish import publisher as publisher_module
from pica_client.publish.publisher import SenderConfig
from pica_client.transport.config import LinkConfig
from pica_core.avatar.file import Avatar, load_avatar
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder, LatentSample, StreamConfig
from pica_core.codec.profile import StreamProfile
from pica_server.config.relay import RelayConfig
from pica_server.relay import Relay
from simnet.clock import current_network, in_virtual_time
from simnet.network import Wire

pytestmark = pytest.mark.call

AVATAR_ID = "5" * 64
FRAME_S = 1 / 30
BASE_S = 4 * FRAME_S


class Seen(NamedTuple):
    """A face that a receiver decoded."""

    at_s: float
    captured_us: int
    latent: npt.NDArray[np.float32]


class Witness:
    """Watches both ends of all streams.

    Attributes:
        truth: What the payload of a frame says, by capture time.
        decoded: What came out of decoders.
        layers: By capture time.
    """

    def __init__(self) -> None:
        self.truth: dict[int, npt.NDArray[np.float32]] = {}
        self.multiples: dict[int, int] = {}
        self.captured_us: dict[bytes, int] = {}
        self.decoded: list[Seen] = []

    def assert_true(self) -> None:
        """Every decoded face is the one that was sent."""
        assert self.decoded
        for seen in self.decoded:
            np.testing.assert_array_equal(seen.latent, self.truth[seen.captured_us])

    def since(self, begin_s: float, end_s: float = 1e9) -> list[Seen]:
        """What was decoded in a span of time."""
        return [seen for seen in self.decoded if begin_s <= seen.at_s < end_s]


class WatchedEncoder:
    def __init__(self, profile: StreamProfile, config: StreamConfig, witness: Witness) -> None:
        self._encoder, self._decoder = LatentEncoder(profile, config), LatentDecoder(profile)
        self._witness = witness
        self.restart = self._encoder.restart

    def encode(self, latent: Any, rotation: Any, translation: Any, now_us: int) -> Any:
        frame = self._encoder.encode(latent, rotation, translation, now_us)
        if frame is not None:
            self._witness.truth[now_us] = self._decoder.decode(frame.payload).latent
            self._witness.multiples[now_us] = frame.multiple
            self._witness.captured_us[frame.payload] = now_us
        return frame


class WatchedDecoder:
    def __init__(self, profile: StreamProfile, witness: Witness) -> None:
        self._decoder, self._witness = LatentDecoder(profile), witness

    def decode(self, payload: bytes) -> LatentSample:
        sample, now = self._decoder.decode(payload), asyncio.get_running_loop().time()
        captured_us = self._witness.captured_us[payload]
        self._witness.decoded.append(Seen(now, captured_us, sample.latent))
        return sample


@pytest.fixture
def witness() -> Iterator[Witness]:
    watching = Witness()

    def encoder(profile: StreamProfile, config: StreamConfig) -> Any:
        return WatchedEncoder(profile, config, watching)

    def decoder(profile: StreamProfile) -> Any:
        return WatchedDecoder(profile, watching)

    with (
        mock.patch.object(publisher_module, "LatentEncoder", encoder),
        mock.patch.object(participant_module, "LatentDecoder", decoder),
    ):
        yield watching


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar(Path(str(resources.files("pica_core"))) / "avatars" / "amara.pica")


def config(url: str, host: str) -> LinkConfig:
    port = url.rpartition(":")[2]
    return LinkConfig(url=f"ws://{host}:{port}", room="kitchen", name=host)


def make_sender(url: str, avatar: Avatar, seconds: float) -> Sender:
    (sender,) = make_senders(
        [config(url, "ada")], [(AVATAR_ID, avatar)], config=SenderConfig(seconds=seconds)
    )
    return sender


def make_receiver(url: str, avatar: Avatar) -> Receiver:
    call = Call(LoadedAvatars({AVATAR_ID: avatar}))
    return Receiver(config(url, "viewer"), call)


class Display:
    """Asks for the faces sixty times a second, and keeps them with the time."""

    def __init__(self, receiver: Receiver) -> None:
        self.faces: list[tuple[float, FaceState]] = []
        self._receiver = receiver

    async def run(self, seconds: float) -> None:
        loop = asyncio.get_running_loop()
        running = asyncio.create_task(self._receiver.run())
        end_s = loop.time() + seconds
        while loop.time() < end_s:
            await asyncio.sleep(1 / 60)
            self.faces += [(loop.time(), face) for face in self._receiver.call.faces(loop.time())]
        self._receiver.stop()
        await running

    def first_face_s(self) -> float:
        return next(at_s for at_s, face in self.faces if face.latent is not None)


@pytest.mark.parametrize("came_at_s", [0.7, 3.05, 5.21, 9.9, 14.4])
@in_virtual_time
async def test_who_joins_late_sees_todays_face_with_the_answer_to_the_join(
    came_at_s: float, witness: Witness, avatar: Avatar
) -> None:
    one_way_s = 0.04
    current_network().route("viewer", up=Wire(delay_s=one_way_s), down=Wire(delay_s=one_way_s))
    loop = asyncio.get_running_loop()
    async with Relay(RelayConfig(port=0)) as relay:
        sending = asyncio.create_task(make_sender(relay.url, avatar, 17).run())
        await asyncio.sleep(came_at_s)
        receiver = make_receiver(relay.url, avatar)
        display = Display(receiver)
        joined_s: list[float] = []
        watching = asyncio.create_task(display.run(2))
        while not joined_s:
            await asyncio.sleep(0.001)
            if receiver.is_connected:
                joined_s.append(loop.time())
        await watching
        stats = receiver.stats(loop.time())
        await sending
    witness.assert_true()
    # What the relay kept comes with the answer; then the stream goes on. (A millisecond to look.)
    first = witness.decoded[0]
    first_s = first.at_s
    assert first_s - joined_s[0] <= FRAME_S + 0.002
    # The join and its answer are one round trip; opening a connection takes two more.
    assert joined_s[0] - came_at_s <= 3 * 2 * one_way_s + 0.01
    assert display.first_face_s() - joined_s[0] <= 2 * FRAME_S + 1 / 60
    # Not an old face, but that of now.
    newest = max(frame.captured_us for frame in witness.since(0, first_s + 0.002)) / 1e6
    assert joined_s[0] - newest <= one_way_s + BASE_S + FRAME_S
    assert stats["errors"] == 0


@in_virtual_time
async def test_a_slow_spell_thins_the_stream_and_every_face_stays_true(
    witness: Witness, avatar: Avatar
) -> None:
    # With their headers 30 frames a second are 8 kbit/s.
    slow = Wire(delay_s=0.02, rate_bps=5600, queue_bytes=300)
    current_network().route("viewer", up=Wire(delay_s=0.02), down=slow)
    async with Relay(RelayConfig(port=0)) as relay:
        sending = asyncio.create_task(make_sender(relay.url, avatar, 32).run())
        receiver = make_receiver(relay.url, avatar)
        display = Display(receiver)
        await display.run(30)
        await sending
        stats = receiver.stats(30)
    witness.assert_true()
    assert stats["errors"] == 0
    seen = witness.since(10, 30)
    assert 15 * 20 <= len(seen) <= 27 * 20
