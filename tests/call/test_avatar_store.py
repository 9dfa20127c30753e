"""A call in which the receiver does not have the sender's avatar: its file goes by the relay.

On loopback and a real clock, because files come and go in threads.
"""

import asyncio
from pathlib import Path

import numpy as np
import pytest

from helpers.store_peers import store_relay, until
from helpers.toy import make_toy_avatar
from pica_client.avatars.fetch import AvatarCache, AvatarFetcher
from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import Call
from pica_client.call.status import FaceState
from pica_client.decode.decoder import OnnxDecoder
from pica_client.endpoint import Receiver, Sender
from pica_client.publish import open_face
from pica_client.transport.connect import LinkConfig
from pica_core.avatar.file import avatar_id, save_avatar

pytestmark = pytest.mark.call


@pytest.mark.parametrize("also_views", [False, True], ids=["sender", "viewer that sends"])
@pytest.mark.asyncio
async def test_a_strangers_face_is_seen_by_who_does_not_have_its_file(
    tmp_path: Path, *, also_views: bool
) -> None:
    path = tmp_path / "stranger.pica"
    save_avatar(path, make_toy_avatar(seed=23))
    identity = avatar_id(path)
    async with store_relay() as relay:
        link = LinkConfig(url=relay.url, name="stranger")
        own = AvatarLibrary(shipped=[])
        outgoing = open_face("performance:talk", link, own, lambda line: None, avatar=str(path))
        giver = outgoing.giver
        assert giver is not None
        sender = Receiver(link, Call(own), outgoing) if also_views else Sender(link, outgoing)
        library = AvatarLibrary(shipped=[])
        fetcher = AvatarFetcher(library, lambda: relay.url, cache=AvatarCache(tmp_path / "cache"))
        call = Call(fetcher)
        receiver = Receiver(LinkConfig(url=relay.url, name="viewer"), call)
        loop = asyncio.get_running_loop()
        notes: list[str] = []

        def face() -> FaceState | None:
            faces = call.faces(loop.time())
            notes.extend(each.note for each in faces if each.note and each.note not in notes)
            return faces[0] if faces and faces[0].latent is not None else None

        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(receiver.run())
                await until(lambda: receiver.link.is_joined)
                tasks.create_task(sender.run())
                await until(lambda: face() is not None)
                shown, avatar = face(), call.avatar(identity)
                sender.stop()
                receiver.stop()
            assert shown is not None
            assert shown.latent is not None
            assert avatar is not None
            decoded = OnnxDecoder(avatar).decode(shown.latent, np.array([0, 0, 1], np.float32))
            assert decoded.position_map.shape == (256, 256, 3)
            assert np.isfinite(decoded.position_map).all()
            assert giver.outcome == "given"
            assert fetcher.num_fetched == 1
        finally:
            fetcher.close()
            library.close()
            own.close()
        assert relay.stats()["store"]["uploads_kept"] == 1
    assert any("avatar" in note for note in notes)
