"""A room in which some encrypt, one with another secret and one not at all: each is told why."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from helpers.senders import LoadedAvatars, make_senders
from helpers.stream_toy import stream_avatar
from pica_client.call.call import Call
from pica_client.call.roster import Member
from pica_client.e2ee.secret import RoomSecret, save_secret
from pica_client.endpoint import Receiver
from pica_client.publish import SenderConfig
from pica_client.transport.connect import LinkConfig
from pica_server.config import RelayConfig
from pica_server.relay import Relay
from simnet.clock import in_virtual_time

pytestmark = pytest.mark.call

AVATAR_ID = "5" * 64


class Viewer:
    """Somebody who watches."""

    def __init__(self, link: LinkConfig, avatars: LoadedAvatars) -> None:
        self.receiver = Receiver(link, Call(avatars))
        self.status = self.receiver.status

    def listed(self) -> dict[str, Member]:
        now = asyncio.get_running_loop().time()
        self.receiver.call.faces(now)
        return {each.name: each for each in self.status(now).participants}


@in_virtual_time
async def test_everybody_is_told_why_a_face_is_not_to_be_seen() -> None:
    avatar = stream_avatar()
    avatars = LoadedAvatars({AVATAR_ID: avatar})
    with TemporaryDirectory() as folder:
        ours, theirs = Path(folder) / "ours", Path(folder) / "theirs"
        for file in (ours, theirs):
            save_secret(file, RoomSecret.new())
        async with Relay(RelayConfig(port=0)) as relay:
            port = relay.url.rpartition(":")[2]

            def link(name: str, secret: Path | None) -> LinkConfig:
                base = LinkConfig(url=f"ws://{name.lower()}:{port}", room="kitchen", name=name)
                return replace(base, secret_file=secret)

            senders = make_senders(
                [link("Ada", ours), link("Ben", theirs), link("Cho", None)],
                [(AVATAR_ID, avatar)],
                config=SenderConfig(),
            )
            sealed = Viewer(link("Dee", ours), avatars)
            plain = Viewer(link("Eve", None), avatars)
            running = [asyncio.create_task(each.run()) for each in senders]
            running += [asyncio.create_task(each.receiver.run()) for each in (sealed, plain)]
            await asyncio.sleep(8)
            plain.listed()
            seen = sealed.listed()
            assert [name for name, each in seen.items() if each.is_verified] == ["Ada"]
            assert {name: each.line for name, each in seen.items()} == {
                "Dee": "watching",
                "Ada": "",
                "Ben": "secret differs: compare the secret files",
                "Cho": "not encrypted",
                "Eve": "not encrypted",
            }
            status = sealed.status(asyncio.get_running_loop().time())
            assert status.is_encrypted
            assert len(status.code.split()) == 6

            needed = "encrypted: the room's secret is needed"
            lines = {name: each.line for name, each in plain.listed().items()}
            assert (lines["Ada"], lines["Ben"], lines["Cho"]) == (needed, needed, "")
            assert plain.status(0.0).code == ""
            for sender in senders:
                sender.stop()
            for viewer in (sealed, plain):
                viewer.receiver.stop()
            await asyncio.gather(*running)
