"""The avatar store of a real relay on loopback, used badly: by strangers, full, broken."""

import asyncio
import errno
import os
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed

from helpers.store_peers import (
    ask,
    chunks_of,
    fake_avatar,
    id_of,
    left_in,
    store_relay,
    store_socket,
    talk,
    until_counted,
    upload,
)
from pica_protocol.codec import encode_chunk, encode_message
from pica_protocol.errors import CloseCode
from pica_protocol.messages import Bye, Offer, Ready
from pica_server.config import StoreConfig
from pica_server.store.store import AvatarStore
from simnet.peers import peer_in_room

pytestmark = [pytest.mark.call, pytest.mark.asyncio]

FILE = fake_avatar()
ID = id_of(FILE)


@pytest.mark.parametrize(
    ("offer", "data", "code", "words"),
    [
        ({"sha256": "00" * 32}, FILE, CloseCode.UNFIT_FILE, "SHA-256"),
        ({"size": len(FILE) - 1}, FILE, CloseCode.UNFIT_FILE, "bytes"),
        ({"size": 2**24 + 1}, FILE, CloseCode.STORE_FULL, "no file above 16777216"),
        ({"size": 2**40}, FILE, CloseCode.STORE_FULL, "no file above"),
    ],
)
async def test_a_file_that_is_not_what_it_should_be_is_refused_and_leaves_nothing(
    offer: dict[str, object], data: bytes, code: CloseCode, words: str, tmp_path: Path
) -> None:
    async with store_relay(tmp_path) as relay:
        outcome = await upload(relay, data, **offer)
        assert outcome.code == code
        assert words in outcome.reason
        assert relay.store is not None
        assert relay.store.used_bytes == 0
        assert (await upload(relay, FILE)).code == CloseCode.NORMAL  # and all goes on
    assert left_in(tmp_path) == {f"{ID}.pica"}


OFFER = encode_message(Offer(sha256=ID, size=len(FILE)))


@pytest.mark.parametrize(
    ("messages", "code"),
    [
        (["offer"], CloseCode.MALFORMED),
        ([b""], CloseCode.MALFORMED),
        ([encode_message(Ready())], CloseCode.UNEXPECTED_MESSAGE),
        ([encode_message(Bye(code=1000))], CloseCode.UNEXPECTED_MESSAGE),
        ([encode_chunk(FILE[:100])], CloseCode.MALFORMED),
        ([OFFER, OFFER], CloseCode.MALFORMED),
        ([OFFER, b"\x03"], CloseCode.MALFORMED),
        ([OFFER, "text"], CloseCode.MALFORMED),
        ([OFFER.replace(ID.encode(), b"../" + ID[3:].encode())], CloseCode.MALFORMED),
        ([OFFER.replace(ID.encode(), ID.upper().encode())], CloseCode.MALFORMED),
        ([OFFER, bytes(16_385)], CloseCode.MESSAGE_TOO_BIG),
    ],
)
async def test_who_does_not_speak_the_protocol_is_closed_with_a_code(
    messages: list[bytes | str], code: CloseCode, tmp_path: Path
) -> None:
    async with store_relay(tmp_path) as relay:
        assert (await talk(relay, messages)).code == code
        assert (await upload(relay, FILE)).code == CloseCode.NORMAL
    assert left_in(tmp_path) == {f"{ID}.pica"}


@pytest.mark.parametrize(
    "path",
    [
        "/avatars/",
        "/avatars/..",
        "/avatars/../../etc/passwd",
        "/avatars/%2e%2e/secret",
        f"/avatars/{ID}/../../secret",
        f"/avatars/{ID}.pica",
        f"/avatars//{ID}",
        f"/avatars/{ID.upper()}",
        f"/avatars/incoming/{ID}",
        "/avatars/" + "a" * 5000,
    ],
)
async def test_no_path_leads_out_of_the_store(path: str, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("secret")
    async with store_relay(tmp_path / "store") as relay:
        await upload(relay, FILE)
        reply = await ask(relay, path)
        assert reply.status == 404
        assert b"secret" not in reply.body
        assert (await ask(relay, f"/avatars/{ID}", method="DELETE")).status == 405


async def test_what_lies_in_the_folder_under_another_name_is_not_given(tmp_path: Path) -> None:
    for name in ("notes.txt", f"{ID}.pica.bak", f"x{ID}.pica"):
        (tmp_path / name).write_bytes(FILE)
    (tmp_path / ("cd" * 32 + ".pica")).symlink_to("/etc/passwd")
    store = AvatarStore(str(tmp_path), StoreConfig())
    assert store.num_avatars == 0
    store.close()


async def test_an_upload_that_breaks_off_leaves_nothing_and_gives_its_room_back(
    tmp_path: Path,
) -> None:
    async with store_relay(tmp_path, quota_bytes=len(FILE)) as relay:
        async with store_socket(relay) as websocket:
            await websocket.send(OFFER)
            await websocket.recv()
            await websocket.send(chunks_of(FILE)[0])
            assert (await upload(relay, FILE)).code == CloseCode.STORE_FULL  # its room is taken
            websocket.transport.abort()
        await until_counted(relay, "uploads_cut")
        assert (await upload(relay, FILE)).code == CloseCode.NORMAL
    assert left_in(tmp_path) == {f"{ID}.pica"}


async def test_who_sends_too_slowly_or_nothing_is_closed(tmp_path: Path) -> None:
    limits = {"grace_s": 0.05, "slowest_bytes_per_s": 1e9}
    async with store_relay(tmp_path, config={"handshake_timeout_s": 0.2}, **limits) as relay:
        assert (await talk(relay, [OFFER])).code == CloseCode.TOO_SLOW
        assert (await talk(relay, [])).code == CloseCode.TOO_SLOW
    assert left_in(tmp_path) == set()


async def test_a_reader_that_stops_is_cut_and_its_place_is_free_again(tmp_path: Path) -> None:
    large = fake_avatar(8_000_000)
    limits = {"grace_s": 1.0, "slowest_bytes_per_s": 1e9}
    async with store_relay(tmp_path, downloads=1, **limits) as relay:
        await upload(relay, large)
        host, _, port = relay.url.removeprefix("ws://").rpartition(":")
        _, writer = await asyncio.open_connection(host, int(port), limit=1024)
        writer.write(f"GET /avatars/{id_of(large)} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        await until_counted(relay, "downloads")
        busy = await ask(relay, f"/avatars/{id_of(large)}")
        assert (busy.status, busy.headers["retry-after"]) == (503, "1")
        await until_counted(relay, "downloads_cut")
        assert (await ask(relay, f"/avatars/{id_of(large)}")).status == 200
        writer.transport.abort()
        assert relay.stats()["limits_hit"] == {}


async def test_more_uploads_at_once_than_allowed_are_told_to_come_later(tmp_path: Path) -> None:
    async with store_relay(tmp_path, uploads=1) as relay, store_socket(relay) as first:
        await first.send(OFFER)
        await first.recv()
        assert (await upload(relay, fake_avatar(seed=1))).code == CloseCode.BUSY
        await first.close()


async def test_who_offers_nothing_takes_no_place_of_those_who_upload(tmp_path: Path) -> None:
    async with store_relay(tmp_path, uploads=1) as relay, store_socket(relay), store_socket(relay):
        assert (await upload(relay, FILE)).code == CloseCode.NORMAL


async def test_a_full_store_refuses_clearly_and_still_gives(tmp_path: Path) -> None:
    async with store_relay(tmp_path, quota_bytes=len(FILE) + 10) as relay:
        await upload(relay, FILE)
        outcome = await upload(relay, fake_avatar(seed=1))
        assert outcome.code == CloseCode.STORE_FULL
        assert outcome.reason == f"its {len(FILE) + 10} bytes are taken"
        assert (await ask(relay, f"/avatars/{ID}")).status == 200
    async with store_relay(tmp_path, max_avatars=1) as relay:
        outcome = await upload(relay, fake_avatar(seed=1))
        assert outcome.code == CloseCode.STORE_FULL
        assert outcome.reason == "it has 1 avatars, the most it may"


async def test_a_full_disk_is_a_full_store_and_costs_nobody_a_call(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_room(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    async with store_relay(tmp_path) as relay, peer_in_room(relay.url, "Ada") as ada:
        monkeypatch.setattr(os, "fsync", no_room)
        assert (await upload(relay, FILE)).code == CloseCode.STORE_FULL
        assert ada.session.closed is None
    assert left_in(tmp_path) == set()


async def test_a_place_that_breaks_is_a_fault_of_the_relay_without_details(tmp_path: Path) -> None:
    folder = tmp_path / "store"
    async with store_relay(folder) as relay:
        folder.rmdir()
        folder.write_bytes(b"no folder any more")
        outcome = await upload(relay, FILE)
        assert (outcome.code, outcome.reason) == (CloseCode.INTERNAL_ERROR, "the store has a fault")
        reply = await ask(relay, f"/avatars/{ID}")
        assert (reply.status, str(tmp_path).encode() in reply.body) == (503, False)


async def test_a_relay_that_stops_waits_for_no_transfer(tmp_path: Path) -> None:
    async with store_relay(tmp_path) as relay:
        async with store_socket(relay) as websocket:
            await websocket.send(OFFER)
            await websocket.recv()
            await relay.__aexit__(None, None, None)
            with pytest.raises(ConnectionClosed):
                await websocket.recv()
        await relay.__aenter__()
    assert left_in(tmp_path) == set()
