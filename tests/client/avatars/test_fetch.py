"""Avatars that go to and come from a relay's store: late, wrong, not at all."""

import asyncio
import hashlib
import os
import threading
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import pytest

from helpers.certificates import write_certificate
from helpers.store_peers import ask, fake_avatar, id_of, store_relay, until, upload
from helpers.toy import make_toy_avatar
from pica_client.avatars import fetch as avatar_fetch
from pica_client.avatars.fetch import AvatarCache, AvatarFetcher, download, store_url
from pica_client.avatars.library import AvatarLibrary
from pica_client.avatars.upload import AvatarGiver, push_avatar
from pica_client.errors import RelayRefusedError, RelayUnreachableError
from pica_client.transport.connect import LinkConfig
from pica_core.avatar.file import Avatar, load_avatar, save_avatar
from pica_core.errors import AvatarFileError

pytestmark = pytest.mark.call

FILE = fake_avatar(300_000)
ID = id_of(FILE)


class AvatarFile(NamedTuple):
    path: Path
    data: bytes
    identity: str


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> AvatarFile:
    """A real avatar file."""
    path = tmp_path_factory.mktemp("toy") / "toy.pica"
    save_avatar(path, make_toy_avatar())
    data = path.read_bytes()
    return AvatarFile(path, data, id_of(data))


@contextmanager
def bad_relay(
    *,
    data: bytes = FILE,
    status: int = 200,
    breaks_after: int | None = None,
    headers: Mapping[str, str] = MappingProxyType({}),
) -> Iterator[str]:
    """The address of an HTTP server that answers so, and breaks connections after so many bytes."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(status)
            for name, value in ({"Content-Length": str(len(data))} | dict(headers)).items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(data[:breaks_after])

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"ws://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


# Getting


def test_the_store_is_where_the_relay_is() -> None:
    assert store_url("ws://host:8765", "x") == "http://host:8765/avatars/x"
    assert store_url("wss://[::1]/relay/", "x") == "https://[::1]/relay/avatars/x"


@pytest.mark.parametrize(
    ("settings", "is_final"),
    [
        ({"status": 404}, False),
        ({"status": 503}, False),
        ({"status": 501}, True),
        ({"status": 302, "headers": {"Location": "http://127.0.0.1:1/"}}, True),
        ({"data": b"another file"}, True),
        ({"headers": {"Content-Length": str(2**40)}}, True),
        ({"headers": {"Content-Length": "many"}}, False),
        ({"breaks_after": 0}, False),
        ({"breaks_after": 10}, False),
    ],
)
def test_another_answer_of_a_relay_is_an_error(settings: dict[str, Any], is_final: bool) -> None:
    error = RelayRefusedError if is_final else RelayUnreachableError
    with bad_relay(**settings) as url, pytest.raises(error):
        download(url, ID)


def test_a_file_comes_whole_unless_it_is_no_longer_wanted_or_takes_too_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ratios: list[float] = []
    with bad_relay() as url:
        data = download(url, ID, progress=lambda ratio: ratios.append(ratio) or True)
        assert data == FILE
        assert ratios == sorted(ratios)
        assert ratios[-1] == 1
        with pytest.raises(RelayUnreachableError, match="no longer wanted"):
            download(url, ID, progress=lambda ratio: False)
        monkeypatch.setattr(avatar_fetch, "MAX_DOWNLOAD_S", -1.0)
        with pytest.raises(RelayUnreachableError, match="too slowly"):
            download(url, ID)


# The cache


def test_a_cache_gives_back_what_it_was_given_and_drops_what_was_used_longest_ago(
    tmp_path: Path,
) -> None:
    cache = AvatarCache(tmp_path, max_bytes=250)
    files = {hashlib.sha256(bytes([i]) * 100).hexdigest(): bytes([i]) * 100 for i in range(3)}
    for age, (identity, data) in enumerate(files.items()):
        os.utime(cache.keep(identity, data), (1e9 + age, 1e9 + age))
        if age == 1:
            assert cache.find(next(iter(files))) is not None  # used: now it is the newest
    assert [cache.find(identity) is not None for identity in files] == [True, False, True]
    next(tmp_path.iterdir()).write_bytes(b"damaged")
    assert sum(cache.find(identity) is not None for identity in files) == 1
    assert len(list(tmp_path.iterdir())) == 1


# The library that fetches


@contextmanager
def fetcher(url: str | Callable[[], str], folder: Path) -> Iterator[AvatarFetcher]:
    library = AvatarLibrary(shipped=[])
    fetching = AvatarFetcher(
        library, url if callable(url) else lambda: url, cache=AvatarCache(folder)
    )
    try:
        yield fetching
    finally:
        fetching.close()
        library.close()


@asynccontextmanager
async def relay_with(*files: bytes) -> AsyncIterator[str]:
    async with store_relay() as relay:
        for data in files:
            await upload(relay, data)
        yield relay.url


@pytest.mark.asyncio
async def test_a_missing_avatar_comes_from_the_relay_and_then_from_the_disk(
    tmp_path: Path, toy: AvatarFile
) -> None:
    async with relay_with(toy.data) as url:
        with fetcher(url, tmp_path) as fetching:
            assert fetching.get(toy.identity) is None
            assert fetching.note(toy.identity).startswith("avatar is on its way")
            await until(lambda: fetching.get(toy.identity) is not None)
            assert fetching.note(toy.identity) == ""
            assert fetching.num_fetched == 1
    with fetcher("ws://127.0.0.1:9", tmp_path) as fetching:
        await until(lambda: fetching.get(toy.identity) is not None)
        assert fetching.num_fetched == 0


@pytest.mark.asyncio
async def test_a_malformed_file_is_an_error_for_its_face_alone_and_is_not_kept(
    tmp_path: Path, toy: AvatarFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    strange = fake_avatar(1000)

    def load(data: bytes) -> Avatar:
        if data == strange:
            raise OverflowError("nobody has thought of this")
        return load_avatar(data)

    monkeypatch.setattr(avatar_fetch, "load_avatar", load)
    async with relay_with(FILE, strange, toy.data) as url:
        with fetcher(url, tmp_path) as fetching:
            for identity, words in ((ID, "manifest"), (id_of(strange), "cannot be read")):
                fetching.get(identity)
                await until(lambda words=words, name=identity: words in fetching.note(name))
                with pytest.raises(AvatarFileError, match=words):
                    fetching.get(identity)
            await until(lambda: fetching.get(toy.identity) is not None)
    assert os.listdir(tmp_path) == [f"{toy.identity}.pica"]


@pytest.mark.asyncio
async def test_an_avatar_that_will_not_come_is_an_error_with_the_fix(tmp_path: Path) -> None:
    words = "is missing: the relay keeps no avatars; get "
    with bad_relay(status=501) as url, fetcher(url, tmp_path) as fetching:
        fetching.get(ID)
        await until(lambda: words in fetching.note(ID))
        with pytest.raises(AvatarFileError, match=words):
            fetching.get(ID)
    assert os.listdir(tmp_path) == []


@pytest.mark.asyncio
async def test_a_relay_that_is_away_is_asked_again(tmp_path: Path, toy: AvatarFile) -> None:
    urls = ["ws://127.0.0.1:9"]
    async with relay_with(toy.data) as url:
        with fetcher(lambda: urls[-1], tmp_path) as fetching:
            fetching.get(toy.identity)
            await until(lambda: fetching.note(toy.identity).startswith("avatar file is missing"))
            urls.append(url)
            await until(lambda: fetching.get(toy.identity) is not None)


def test_more_wanted_avatars_than_can_be_forget_the_one_asked_for_longest_ago(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(avatar_fetch, "MAX_WANTED", 2)
    with bad_relay(status=404) as url, fetcher(url, tmp_path) as fetching:
        for number in range(3):
            fetching.get(f"{number:064x}")
        assert [fetching.note(f"{number:064x}") != "" for number in range(3)] == [False, True, True]


# Giving


@pytest.mark.asyncio
async def test_under_tls_avatars_go_both_ways_for_who_trusts_the_relay(
    toy: AvatarFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cert = write_certificate(tmp_path)
    config = {"tls_cert": cert, "tls_key": cert.with_suffix(".key")}
    async with store_relay(config=config) as relay:
        assert relay.url.startswith("wss://")
        giving = partial(push_avatar, relay.url, LinkConfig(url=relay.url))
        with pytest.raises(RelayRefusedError):
            await giving(toy.path, toy.identity)
        with pytest.raises(RelayUnreachableError):
            await asyncio.to_thread(download, relay.url, toy.identity)
        monkeypatch.setenv("SSL_CERT_FILE", str(cert))
        await giving(toy.path, toy.identity)
        got = await asyncio.to_thread(download, relay.url, toy.identity)
        assert got == toy.data


@pytest.mark.asyncio
async def test_a_giver_gives_to_each_relay_and_tells_once_what_went_wrong(toy: AvatarFile) -> None:
    said: list[str] = []
    giver = AvatarGiver(LinkConfig(), toy.path, toy.identity, said.append)
    async with store_relay() as one, store_relay("none") as other:
        giver.begin(one.url)
        giver.begin(one.url)  # is at it already
        await until(lambda: giver.outcome == "given")
        assert one.stats()["store"]["uploads_kept"] == 1
        assert (await ask(one, f"/avatars/{toy.identity}")).body == toy.data
        for _ in range(2):
            giver.begin(other.url)
            await until(lambda: giver.outcome == "this relay keeps no avatars")
        giver.begin(one.url)
        await until(lambda: giver.outcome == "known")
    await giver.close()
    assert len(said) == 2
