"""Streams of heads off the screen, through the real relay on the virtual clock: what they cost, and
how soon the face of now is there when the head comes back.

Sender and receiver are the product's, with a shipped avatar. Code takes no time on a virtual clock:
delays are those of the network and of our own waiting.
"""

import asyncio
from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from helpers.senders import LoadedAvatars, make_senders
from pica_client.call.call import Call
from pica_client.call.status import FaceState
from pica_client.endpoint import Receiver, Sender
from pica_client.publish import SenderConfig
from pica_client.sources import open_source
from pica_client.transport.connect import LinkConfig
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar, load_avatar
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from simnet.clock import current_network, in_virtual_time
from simnet.network import Wire

pytestmark = pytest.mark.call

AVATAR_ID = "6" * 64
SOURCE = "performance:talk"
DISPLAY_FRAME_S = 1 / 30
ONE_WAY_S = 0.012


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar(Path(str(resources.files("pica_core"))) / "avatars" / "amara.pica")


def make_sender(url: str, avatar: Avatar, seconds: float) -> Sender:
    config = LinkConfig(url=_from("ada", url), room="kitchen", name="ada")
    (sender,) = make_senders(
        [config],
        [(AVATAR_ID, avatar)],
        config=SenderConfig(seconds=seconds),
        sources=[open_source(SOURCE)],
    )
    return sender


def make_receiver(url: str, avatar: Avatar) -> Receiver:
    config = LinkConfig(url=_from("viewer", url), room="kitchen", name="viewer")
    call = Call(LoadedAvatars({AVATAR_ID: avatar}))
    return Receiver(config, call)


def _from(host: str, url: str) -> str:
    return f"ws://{host}:{url.rpartition(':')[2]}"


class Viewer:
    """Looks thirty times a second, and subscribes each time to what it sees."""

    def __init__(self, receiver: Receiver) -> None:
        self.receiver = receiver
        self.every = 1
        self.faces: list[tuple[float, FaceState]] = []
        self.looked = asyncio.Event()

    async def run(self, seconds: float) -> None:
        loop = asyncio.get_running_loop()
        running = asyncio.create_task(self.receiver.run())
        end_s = loop.time() + seconds
        while loop.time() < end_s:
            await asyncio.sleep(DISPLAY_FRAME_S)
            now = loop.time()
            for face in self.receiver.call.faces(now):
                self.receiver.call.subscribe(face.peer_id, self.every, now)
                self.faces.append((now, face))
            self.looked.set()
        self.receiver.stop()
        await running

    async def subscribe_from_now(self, every: int) -> float:
        """Subscribe to something else from the next display frame on; return its time."""
        self.every = every
        self.looked.clear()
        await self.looked.wait()
        return self.faces[-1][0]

    def num_frames(self) -> int:
        (peer,) = self.receiver.call.stats(0.0)["peers"]
        return int(peer["received"])

    def after(self, begin_s: float) -> list[tuple[float, FaceState]]:
        return [(at_s, face) for at_s, face in self.faces if at_s > begin_s]


class Truth:
    """The face that the tracker saw at any moment."""

    def __init__(self, avatar: Avatar, began_s: float) -> None:
        self._source, self._encoder = open_source(SOURCE), ExpressionEncoder(avatar)
        self._began_s = began_s

    def latent(self, captured_us: int) -> npt.NDArray[np.float32]:
        frame = self._source.frame_at(captured_us / 1e6 - self._began_s)
        return self._encoder.encode(frame.arkit)


def distance(one: npt.NDArray[np.float32], other: npt.NDArray[np.float32]) -> float:
    return float(np.sqrt(np.mean(np.square(one - other))))


@in_virtual_time
async def test_back_in_view_the_face_of_now_is_there_within_two_display_frames(
    avatar: Avatar,
) -> None:
    current_network().route("viewer", up=Wire(delay_s=ONE_WAY_S), down=Wire(delay_s=ONE_WAY_S))
    loop = asyncio.get_running_loop()
    async with Relay(RelayConfig(port=0)) as relay:
        began_s = loop.time()
        sending = asyncio.create_task(make_sender(relay.url, avatar, 24).run())
        viewer = Viewer(make_receiver(relay.url, avatar))
        watching = asyncio.create_task(viewer.run(23))
        await asyncio.sleep(5)
        num_seen = viewer.num_frames()
        viewer.every = 0
        await asyncio.sleep(14)
        num_unseen = viewer.num_frames() - num_seen
        back_s = await viewer.subscribe_from_now(1)
        await watching
        await sending
    # Half a second of it is the wait before it is told.
    assert num_unseen / 14 <= 0.06 * num_seen / 4
    truth = Truth(avatar, began_s)
    shown = viewer.after(back_s)
    second_s, second = shown[1]
    assert second_s - back_s <= 2 * DISPLAY_FRAME_S + 1e-6
    assert second_s - second.captured_us / 1e6 <= 3 * DISPLAY_FRAME_S + ONE_WAY_S
    # It is the face itself, not one on its way there from the old one.
    assert second.latent is not None
    usual = [
        distance(face.latent, truth.latent(face.captured_us))
        for at_s, face in viewer.faces
        if 2 < at_s < 5 and face.latent is not None
    ]
    assert distance(second.latent, truth.latent(second.captured_us)) <= 2 * np.percentile(usual, 95)
    moves_s = back_s + 3 * DISPLAY_FRAME_S + 2 * ONE_WAY_S
    assert {face.status for at_s, face in shown if at_s > moves_s} == {"live"}
    times_us = [face.captured_us for _, face in viewer.faces if face.latent is not None]
    assert times_us == sorted(times_us)
