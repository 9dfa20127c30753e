"""``pica room`` against a relay that really listens."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pica_server.cli.room import (
    AdminOptions,
    BarOptions,
    MuteOptions,
    RemoveOptions,
    RoomOptions,
    UnbarOptions,
    room_bar,
    room_close,
    room_inspect,
    room_list,
    room_mute,
    room_remove,
    room_unbar,
    room_unmute,
)
from pica_server.cli.token import TokenOptions, token
from pica_server.config.relay import RelayConfig
from pica_server.errors import AdminRequestError, ConfigurationError
from pica_server.relay import Relay
from simnet.peers import peer_in_room

pytestmark = pytest.mark.call


def with_relay(
    config: RelayConfig, act: Callable[[str, str], dict[str, Any]], token_text: str = ""
) -> dict[str, Any]:
    """Run a relay with Ada in it, and a command in a thread beside it."""

    async def main() -> dict[str, Any]:
        async with (
            Relay(config) as relay,
            peer_in_room(relay.url, "Ada", token=token_text) as ada,
        ):
            assert relay.admin is not None
            url = f"http://127.0.0.1:{relay.admin.port}"
            return await asyncio.to_thread(act, url, ada.session.peer_id)

    return asyncio.run(main())


LOCAL = RelayConfig(port=0, admin_port=0, avatar_store="none")


def test_rooms_are_listed_inspected_muted_and_closed_from_the_command_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def act(url: str, peer: str) -> dict[str, Any]:
        assert room_list(AdminOptions(url=url))["rooms"][0]["num_peers"] == 1
        assert room_inspect(RoomOptions(url=url, room="lobby"))["peers"][0]["peer_id"] == peer
        assert room_mute(MuteOptions(url=url, room="lobby", peer=peer))["muted"]
        assert not room_unmute(MuteOptions(url=url, room="lobby", peer=peer, stream=1))["muted"]
        with pytest.raises(AdminRequestError, match="no such peer in the room"):
            room_remove(RemoveOptions(url=url, room="lobby", peer="p 99/x"))
        with pytest.raises(AdminRequestError, match="no such room"):
            room_close(RoomOptions(url=url, room="../v1/rooms"))
        assert not room_remove(RemoveOptions(url=url, room="lobby", peer=peer, bar=True))["barred"]
        return room_list(AdminOptions(url=url))

    assert with_relay(LOCAL, act) == {"rooms": []}
    told = capsys.readouterr().out
    assert "lobby: 1 peers, 1 streams" in told
    assert "nothing keeps them from coming again" in told


def test_with_keys_the_command_shows_a_token_from_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys, file = tmp_path / "keys", tmp_path / "token"
    token(TokenOptions(keys=keys, new_key=True))
    joining = token(TokenOptions(keys=keys, identity="ada", avatars=("any",)))["token"]
    minted = token(TokenOptions(keys=keys, room="*", identity="op", admin=True))["token"]
    file.write_text(minted + "\n")
    config = RelayConfig(port=0, admin_port=0, keys=keys, avatar_store="none")

    def act(url: str, peer: str) -> dict[str, Any]:
        with pytest.raises(AdminRequestError, match="show an admin's token"):
            room_list(AdminOptions(url=url))
        return room_inspect(RoomOptions(url=url, room="lobby", token_file=file))

    assert with_relay(config, act, joining)["peers"][0]["identity"] == "ada"

    def keep_out(url: str, peer: str) -> dict[str, Any]:
        options = {"url": url, "room": "lobby", "token_file": file}
        assert room_remove(RemoveOptions(**options, peer=peer, bar=True, for_s=60))["barred"]
        assert room_bar(BarOptions(**options, identity="bob"))["barred"]
        return room_unbar(UnbarOptions(**options, identity="bob"))

    assert not with_relay(config, keep_out, joining)["barred"]
    assert minted not in capsys.readouterr().err


def test_a_relay_that_is_not_there_is_one_line_with_the_fix() -> None:
    with pytest.raises(AdminRequestError, match=r"no relay answers admins .* --admin-port"):
        room_list(AdminOptions(url="http://127.0.0.1:9"))


def test_what_is_no_address_or_no_token_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="--url ws://a is no address"):
        AdminOptions(url="ws://a")
    with pytest.raises(ConfigurationError, match="--token-file"):
        room_list(AdminOptions(token_file=tmp_path / "none"))
