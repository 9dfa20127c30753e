"""Admin port and webhooks of a whole relay, on the virtual clock, with an HTTP server beside it."""

import asyncio
import hashlib
import hmac
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import h11
import pytest

from pica_protocol.messages import StreamMuted
from pica_protocol.session import Closed
from pica_server.auth.tokens import Admission, KeyRing, load_keys, mint
from pica_server.config.relay import RelayConfig, WebhookConfig
from pica_server.errors import ConfigurationError
from pica_server.relay import Relay
from simnet.clock import current_network, in_virtual_time
from simnet.peers import now, peer_in_room

pytestmark = pytest.mark.call

URL = "ws://relay:8765"
ADMIN = RelayConfig(admin_port=8766)


async def raw(data: bytes, *, port: int = 8766) -> bytes:
    reader, writer = await asyncio.open_connection("relay", port)
    writer.write(data)
    answer = b""
    with suppress(ConnectionResetError):  # who is cut may still hear why
        while part := await reader.read(4096):
            answer += part
    writer.transport.abort()
    return answer


async def ask(method: str, path: str, token: str = "") -> tuple[int, dict[str, object]]:
    shown = f"Authorization: Bearer {token}\r\n" if token else ""
    request = f"{method} {path} HTTP/1.1\r\nHost: localhost\r\n{shown}\r\n"
    head, _, body = (await raw(request.encode())).partition(b"\r\n\r\n")
    return int(head.split()[1]), json.loads(body)


@in_virtual_time
async def test_an_admin_mutes_removes_and_closes_over_http() -> None:
    async with (
        Relay(ADMIN) as relay,
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob") as bob,
        peer_in_room(URL, "Cyd") as cyd,
    ):
        assert relay.admin is not None
        assert relay.admin.port == 8766
        assert (await ask("GET", "/v1/rooms"))[1]["rooms"][0]["num_peers"] == 3  # type: ignore[index]
        assert (await ask("PUT", f"/v1/rooms/lobby/peers/{ada.session.peer_id}/muted"))[0] == 200
        assert (await bob.until(StreamMuted)).is_muted
        assert (await ask("DELETE", f"/v1/rooms/lobby/peers/{ada.session.peer_id}"))[0] == 200
        assert (await ada.until(Closed)).code == 4016
        assert (await ask("DELETE", "/v1/rooms/lobby")) == (200, {"room": "lobby", "removed": 2})
        assert (await bob.until(Closed)).code == (await cyd.until(Closed)).code == 4017


@in_virtual_time
async def test_with_keys_the_admin_port_wants_an_admins_token(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    path.write_text(KeyRing.new_line())
    keys = load_keys(path)

    def token(*, may_admin: bool) -> str:
        admission = Admission(identity="op", may_admin=may_admin)
        return mint(keys, "lobby", admission, now=0.0, lasts_s=60, starts_s=0)

    config = RelayConfig(admin_port=8766, keys=path, admin_host="0.0.0.0")
    async with Relay(config, unix_time=lambda: 1.0):
        assert (await ask("GET", "/v1/rooms"))[0] == 401
        assert (await ask("GET", "/v1/rooms", token(may_admin=False)))[0] == 403
        assert await ask("GET", "/v1/rooms", token(may_admin=True)) == (200, {"rooms": []})


def test_an_admin_port_without_keys_stays_on_this_machine() -> None:
    with pytest.raises(ConfigurationError, match=r"--admin-host 0\.0\.0\.0 can be reached"):
        RelayConfig(admin_port=8766, admin_host="0.0.0.0")
    assert RelayConfig(admin_host="0.0.0.0").admin_port is None


@in_virtual_time
async def test_what_is_no_http_is_refused_and_who_says_nothing_is_cut() -> None:
    async with Relay(ADMIN):
        assert (await raw(b"\x16\x03\x01 hello\r\n\r\n")).startswith(b"HTTP/1.1 400 ")
        long = b"GET / HTTP/1.1\r\nHost: localhost\r\nX: " + b"x" * 40_000
        assert (await raw(long)).split(b" ")[1] in (b"413", b"431")
        body = b"PUT / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 99999\r\n\r\n" + b"x" * 99_999
        assert (await raw(body)).startswith(b"HTTP/1.1 413 ")
        begin = now()
        assert await raw(b"GET / HT") == b""
        assert now() - begin == pytest.approx(5.0, abs=0.01)
        assert (await ask("GET", "/v1/rooms"))[0] == 200


@in_virtual_time
async def test_sockets_that_say_nothing_do_not_keep_the_others_out_for_long() -> None:
    async with Relay(ADMIN):
        silent = [await asyncio.open_connection("relay", 8766) for _ in range(100)]
        await asyncio.sleep(5.1)
        assert (await ask("GET", "/v1/rooms"))[0] == 200
        for _, writer in silent:
            writer.transport.abort()


class Books:
    """An HTTP server that keeps what it is told, or behaves badly."""

    def __init__(self) -> None:
        self.heard: list[tuple[float, dict[str, str], bytes]] = []
        self.status: int | None = 200
        """None: hang."""

    @property
    def events(self) -> list[str]:
        return [str(json.loads(body)["event"]) for _, _, body in self.heard]

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        http = h11.Connection(h11.SERVER)
        headers, body = {}, b""
        while not isinstance(event := http.next_event(), h11.EndOfMessage):
            if event is h11.NEED_DATA:
                http.receive_data(await reader.read(4096))
            elif isinstance(event, h11.Request):
                headers = {key.decode(): value.decode() for key, value in event.headers}
            elif isinstance(event, h11.Data):
                body += event.data
            else:
                return
        if self.status is None:
            with suppress(ConnectionResetError):
                await reader.read(-1)  # until the other end gives up
        else:
            self.heard.append((now(), headers, body))
            response = h11.Response(status_code=self.status, headers=[("Content-Length", "0")])
            writer.write(http.send(response) or b"")
            await writer.drain()
        writer.transport.abort()


@asynccontextmanager
async def books_at(port: int = 9000) -> AsyncIterator[Books]:
    books = Books()
    server = await asyncio.start_server(books.serve, "books", port)
    try:
        yield books
    finally:
        server.close()
        await asyncio.sleep(0.001)


def webhook(tmp_path: Path, **given: object) -> RelayConfig:
    secret = tmp_path / "secret"
    secret.write_text("s" * 32 + "\n")
    settings = {"url": "http://books:9000/hook?a=1", "secret_file": secret, **given}
    return RelayConfig(webhook=WebhookConfig(**settings))  # type: ignore[arg-type]


def test_a_webhook_hears_who_comes_and_goes_with_a_signature(tmp_path: Path) -> None:
    @in_virtual_time
    async def hold() -> None:
        async with books_at() as books, Relay(webhook(tmp_path), unix_time=lambda: 1.7e9):
            async with peer_in_room(URL, "Ada") as ada:
                await asyncio.sleep(0.1)
                assert books.events == ["room_started", "peer_joined"]
            await asyncio.sleep(0.1)
            assert books.events[2:] == ["peer_left", "room_ended"]
            _, headers, body = books.heard[1]
            assert json.loads(body)["peer_id"] == ada.session.peer_id
            code = hmac.new(b"s" * 32, b"1700000000." + body, hashlib.sha256).hexdigest()
            assert headers["pica-signature"] == f"t=1700000000,v1={code}"
            assert headers["pica-event-id"] == json.loads(body)["id"]

    hold()


def test_a_webhook_that_fails_hangs_and_comes_back_hears_all_of_it_in_order(
    tmp_path: Path,
) -> None:
    @in_virtual_time
    async def hold() -> None:
        relay_with_hooks = Relay(webhook(tmp_path, timeout_s=2.0))
        async with relay_with_hooks as relay:
            async with peer_in_room(URL, "Ada") as ada, peer_in_room(URL, "Bob") as bob:
                await asyncio.sleep(10)  # nobody listens
                async with books_at() as books:
                    books.status = 500
                    await asyncio.sleep(20)
                    books.status = None
                    await asyncio.sleep(60)
                    assert {status for status in books.events} <= {"room_started"}
                    books.heard.clear()
                    books.status = 204
                    begin = now()
                    await ada.publish(num_frames=900, fps=30)
                    await asyncio.sleep(31)  # tried again within a minute
                    assert len(bob.arrivals) == 900
                    assert max(bob.delays_s) < 0.001  # it costs the call nothing
                    assert books.events == ["room_started", "peer_joined", "peer_joined"]
                    assert books.heard[0][0] - begin <= 60
            counts = relay.stats()["webhooks"]
            assert counts["failed"] >= 5

    hold()


def test_a_webhook_that_never_answers_costs_a_bounded_queue_and_a_bounded_goodbye(
    tmp_path: Path,
) -> None:
    @in_virtual_time
    async def hold() -> None:
        config = webhook(tmp_path, max_waiting=10)
        async with books_at() as books:
            books.status = None
            async with Relay(config) as relay:
                for i in range(20):
                    async with peer_in_room(URL, "Ada", room=f"r{i}"):
                        pass
                assert relay.webhooks is not None
                assert len(relay.webhooks.queue) == 10
                assert relay.stats()["webhooks"]["overflow"] == 70
                begin = now()
            assert now() - begin <= 2.1

    hold()


def test_a_hook_on_the_way_out_hears_the_end(tmp_path: Path) -> None:
    @in_virtual_time
    async def hold() -> None:
        async with books_at() as books:
            async with Relay(webhook(tmp_path)), peer_in_room(URL, "Ada") as ada:
                await asyncio.sleep(0.1)
                current_network().reset("relay")
                await ada.until(Closed)
            assert books.events == ["room_started", "peer_joined", "peer_left", "room_ended"]

    hold()


@pytest.mark.parametrize("text", [None, "short"])
def test_a_secret_that_cannot_be_used_is_refused_by_name(tmp_path: Path, text: str | None) -> None:
    secret = tmp_path / "secret"
    if text is not None:
        secret.write_text(text)
    config = RelayConfig(webhook=WebhookConfig(url="http://books", secret_file=secret))
    with pytest.raises(ConfigurationError, match=r"--webhook\.secret-file"):
        Relay(config)
