"""The avatar store of a real relay on loopback: what it is for, who may, what cannot work."""

import tempfile
from pathlib import Path

import pytest

from helpers.store_peers import ask, fake_avatar, id_of, left_in, store_relay, talk, upload
from pica_core.avatar import file as avatar_file
from pica_protocol.codec import encode_message
from pica_protocol.errors import CloseCode
from pica_protocol.messages import Offer
from pica_server.config import ConfigurationError, RelayConfig, StoreConfig
from pica_server.limits import RefusalError
from pica_server.relay import Relay
from pica_server.store.store import AvatarStore, Slots
from pica_server.tokens import Admission, mint, new_key_line, parse_keys

pytestmark = pytest.mark.call

FILE = fake_avatar()
ID = id_of(FILE)


# What it is for


@pytest.mark.asyncio
async def test_what_one_gives_another_gets_byte_for_byte(tmp_path: Path) -> None:
    async with store_relay(tmp_path) as relay:
        assert (await ask(relay, f"/avatars/{ID}")).status == 404
        outcome = await upload(relay, FILE)
        assert outcome.code == CloseCode.NORMAL
        assert outcome.stored is not None
        assert outcome.stored.is_new
        reply = await ask(relay, f"/avatars/{ID}")
        assert (reply.status, reply.body) == (200, FILE)
        assert reply.headers["cache-control"] == "public, max-age=31536000, immutable"
        assert reply.headers["content-length"] == str(len(FILE))
        assert relay.stats()["store"]["uploads_kept"] == 1
        numbers = (await ask(relay, "/metrics")).body.decode().splitlines()
        assert "pica_avatars 1.0" in numbers
        assert f"pica_avatar_store_bytes {float(len(FILE))}" in numbers
        assert 'pica_store_total{what="uploads_kept"} 1.0' in numbers
    assert left_in(tmp_path) == {f"{ID}.pica"}


@pytest.mark.asyncio
async def test_a_store_in_a_folder_outlives_its_relay_and_a_temporary_one_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir()
    for where, is_there in ((tmp_path / "store", True), ("temporary", False)):
        async with store_relay(where) as relay:
            assert (await upload(relay, FILE)).code == CloseCode.NORMAL
        async with store_relay(where) as relay:
            assert (await ask(relay, f"/avatars/{ID}")).status == (200 if is_there else 404)
    assert left_in(tmp_path / "tmp") == set()


@pytest.mark.asyncio
async def test_what_is_there_already_is_not_sent_again(tmp_path: Path) -> None:
    async with store_relay(tmp_path) as relay:
        await upload(relay, FILE)
        offer = encode_message(Offer(sha256=ID, size=len(FILE)))
        outcome = await talk(relay, [offer])
        assert outcome.code == CloseCode.NORMAL
        assert outcome.stored is not None
        assert not outcome.stored.is_new


@pytest.mark.asyncio
async def test_a_file_that_the_operator_removes_is_gone_and_can_be_given_again(
    tmp_path: Path,
) -> None:
    async with store_relay(tmp_path) as relay:
        await upload(relay, FILE)
        (tmp_path / f"{ID}.pica").unlink()
        assert (await ask(relay, f"/avatars/{ID}")).status == 404
        assert (await upload(relay, FILE)).code == CloseCode.NORMAL
        assert (await ask(relay, f"/avatars/{ID}")).status == 200


@pytest.mark.asyncio
async def test_a_page_of_a_listed_origin_may_read_an_avatar_and_no_other(tmp_path: Path) -> None:
    config = {"origins": ("https://pica.example",)}
    async with store_relay(tmp_path, config=config) as relay:
        await upload(relay, FILE)
        listed = await ask(relay, f"/avatars/{ID}", Origin="https://pica.example")
        assert listed.headers["access-control-allow-origin"] == "https://pica.example"
        other = await ask(relay, f"/avatars/{ID}", Origin="https://evil.example")
        assert "access-control-allow-origin" not in other.headers
        assert other.headers["vary"] == "origin"


@pytest.mark.asyncio
async def test_a_relay_without_a_store_says_so_both_ways() -> None:
    async with store_relay("none") as relay:
        assert (await ask(relay, f"/avatars/{ID}")).status == 501
        outcome = await upload(relay, FILE)
        assert outcome.code == CloseCode.WRONG_VERSION
        assert outcome.reason == "this relay keeps no avatars"


# Who may


@pytest.mark.asyncio
async def test_with_keys_only_who_may_wear_an_avatar_may_upload_it(tmp_path: Path) -> None:
    line = new_key_line()
    (tmp_path / "keys").write_text(line)
    ring, now = parse_keys(line), 1e9

    def token(begins_s: float = now, **grants: object) -> str:
        admission = Admission(identity="ada", **grants)  # type: ignore[arg-type]
        return mint(ring, "lobby", admission, now=begins_s, lasts_s=60)

    settings = {"keys": tmp_path / "keys"}
    async with store_relay(tmp_path / "store", config=settings, unix_time=lambda: now) as relay:
        for bad, code in (
            ("", CloseCode.UNAUTHORIZED),
            ("a.b.c", CloseCode.UNAUTHORIZED),
            (token(now - 3600, avatars=(ID,)), CloseCode.UNAUTHORIZED),
            (token(avatars=("cd" * 32,)), CloseCode.FORBIDDEN),
            (token(avatars=(ID,), may_publish=False), CloseCode.FORBIDDEN),
        ):
            assert (await upload(relay, FILE, token=bad)).code == code
        assert left_in(tmp_path / "store") == set()
        assert (await upload(relay, FILE, token=token(avatars=(ID,)))).code == CloseCode.NORMAL
        assert (await ask(relay, f"/avatars/{ID}")).status == 200


@pytest.mark.asyncio
async def test_a_relay_that_lets_anybody_in_takes_files_from_nobody(tmp_path: Path) -> None:
    async with store_relay(tmp_path, config={"insecure": True}) as relay:
        assert (await upload(relay, FILE)).code == CloseCode.FORBIDDEN
    assert left_in(tmp_path) == set()


# Settings that cannot work


def test_a_store_that_cannot_be_written_stops_the_relay_with_the_setting() -> None:
    with pytest.raises(ConfigurationError, match="/proc/nowhere/store cannot be written"):
        Relay(RelayConfig(avatar_store="/proc/nowhere/store"))


def test_more_files_than_a_store_may_hold_are_named_at_the_start(tmp_path: Path) -> None:
    for number in range(3):
        (tmp_path / f"{number:064x}.pica").write_bytes(b"x")
    with pytest.raises(ConfigurationError, match="holds more than 2 avatars"):
        AvatarStore(str(tmp_path), StoreConfig(max_avatars=2))


def test_no_file_is_taken_that_receivers_would_not() -> None:
    assert StoreConfig(largest_bytes=avatar_file.MAX_FILE_BYTES)
    with pytest.raises(ConfigurationError, match=r"--store\.largest-bytes"):
        StoreConfig(largest_bytes=avatar_file.MAX_FILE_BYTES + 1)


def test_slots_are_limited_in_all_and_for_each_address_and_come_back() -> None:
    slots = Slots(limit=3, per_address=2)
    with slots.taken("a"), slots.taken("a"):
        with pytest.raises(RefusalError), slots.taken("a"):
            pass
        with slots.taken("b"), pytest.raises(RefusalError), slots.taken("c"):
            pass
    with slots.taken(""), slots.taken(""), slots.taken(""):
        pass
