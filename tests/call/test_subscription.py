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

from helpers.senders import LoadedAvatars, link_of, make_senders
from pica_client.call.call import Call
from pica_client.call.status import FaceState
from pica_client.endpoint import Receiver
from pica_client.publish import SenderConfig
from pica_client.sources import open_source
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
    faces: list[tuple[float, FaceState]] = []
    async with Relay(RelayConfig(port=0)) as relay, asyncio.TaskGroup() as tasks:
        began_s = loop.time()
        (sender,) = make_senders(
            [link_of(relay.url, "ada")],
            [(AVATAR_ID, avatar)],
            config=SenderConfig(seconds=24),
            sources=[open_source(SOURCE)],
        )
        call = Call(LoadedAvatars({AVATAR_ID: avatar}))
        receiver = Receiver(link_of(relay.url, "viewer"), call)
        tasks.create_task(sender.run())
        tasks.create_task(receiver.run())

        async def look(seconds: float, every: int) -> int:
            """Look thirty times a second, and subscribe to what is seen; frames that came."""
            before = sum(peer["received"] for peer in call.stats(0.0)["peers"])
            for _ in range(round(seconds / DISPLAY_FRAME_S)):
                await asyncio.sleep(DISPLAY_FRAME_S)
                for face in call.faces(loop.time()):
                    call.subscribe(face.peer_id, every, loop.time())
                    faces.append((loop.time(), face))
            return int(call.stats(0.0)["peers"][0]["received"]) - before

        num_seen = await look(5, 1)
        num_unseen = await look(14, 0)
        is_back = len(faces)
        await look(4, 1)
        receiver.stop()
    # Half a second of it is the wait before it is told.
    assert num_unseen / 14 <= 0.06 * num_seen / 4
    truth, back_s = Truth(avatar, began_s), faces[is_back][0]
    second_s, second = faces[is_back + 2]
    assert second_s - back_s <= 2 * DISPLAY_FRAME_S + 1e-6
    assert second_s - second.captured_us / 1e6 <= 3 * DISPLAY_FRAME_S + ONE_WAY_S
    # It is the face itself, not one on its way there from the old one.
    assert second.latent is not None
    usual = [
        distance(face.latent, truth.latent(face.captured_us))
        for at_s, face in faces
        if 2 < at_s < 5 and face.latent is not None
    ]
    assert distance(second.latent, truth.latent(second.captured_us)) <= 2 * np.percentile(usual, 95)
    moves_s = back_s + 3 * DISPLAY_FRAME_S + 2 * ONE_WAY_S
    assert {face.status for at_s, face in faces if at_s > moves_s} == {"live"}
    times_us = [face.captured_us for _, face in faces if face.latent is not None]
    assert times_us == sorted(times_us)
