"""TLS by certificate files: what is refused, and that it is renewed under running calls."""

import asyncio
import shutil
import socket
import ssl
from asyncio import sslproto
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest

from helpers.certificates import write_certificate
from pica_client.errors import RelayRefusedError
from pica_client.transport.connect import LinkConfig, open_websocket
from pica_client.transport.link import Link
from pica_protocol.limits import bound_tls_buffer
from pica_protocol.messages import Joined
from pica_server.config import ConfigurationError, LimitsConfig, RelayConfig
from pica_server.relay import READ_AGAIN_S, Relay
from simnet.clock import in_virtual_time

pytestmark = pytest.mark.call


@pytest.fixture
def cert(tmp_path: Path) -> Path:
    return write_certificate(tmp_path)


def key_of(cert: Path) -> Path:
    return cert.with_suffix(".key")


def loaded(cert: Path, key: Path) -> ssl.SSLContext | None:
    return Relay(RelayConfig(tls_cert=cert, tls_key=key, avatar_store="none")).tls


def test_a_certificate_needs_its_key_beside_it() -> None:
    with pytest.raises(ConfigurationError, match="--tls-cert needs --tls-key beside it"):
        RelayConfig(tls_cert=Path("a.pem"))
    with pytest.raises(ConfigurationError, match="--tls-key needs --tls-cert beside it"):
        RelayConfig(tls_key=Path("a.key"))


def test_files_that_cannot_be_used_are_named_in_one_line(cert: Path, tmp_path: Path) -> None:
    other = write_certificate(tmp_path, "other")
    locked = write_certificate(tmp_path, "locked", password=b"x")
    noise, broken = tmp_path / "noise", tmp_path / "broken"
    noise.write_bytes(b"\x00\xff" * 100)
    broken.write_text("-----BEGIN CERTIFICATE-----\nnonsense\n-----END CERTIFICATE-----\n")
    for pair, complaint in (
        ((tmp_path / "none", key_of(cert)), "--tls-cert .*none: No such file"),
        ((cert, tmp_path), "--tls-key .*: Is a directory"),
        ((noise, key_of(cert)), "--tls-cert .*noise: it is no PEM file"),
        ((cert, key_of(other)), "--tls-key .*other.key: it is not the key of .*relay.pem"),
        ((cert, key_of(locked)), "--tls-key .*locked.key: it is encrypted"),
        ((broken, key_of(cert)), "--tls-cert .*broken: it or its key .* cannot be used"),
        ((cert, cert), "--tls-cert .*relay.pem: it or its key .* cannot be used"),
    ):
        with pytest.raises(ConfigurationError, match=complaint) as caught:
            loaded(*pair)
        assert "\n" not in str(caught.value)


@in_virtual_time
async def test_files_are_read_again_and_what_cannot_be_used_never_replaces_what_can(
    cert: Path, tmp_path: Path
) -> None:
    async with Relay(RelayConfig(tls_cert=cert, tls_key=key_of(cert))) as relay:
        first = relay.tls
        other = write_certificate(tmp_path, "other")
        shutil.copy(other, cert)  # and not its key, yet
        await asyncio.sleep(READ_AGAIN_S + 1)
        assert relay.tls is first
        shutil.copy(key_of(other), key_of(cert))
        await asyncio.sleep(READ_AGAIN_S)
        assert relay.tls is not first


def client_context() -> ssl.SSLContext:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context


def served_certificate(host: str, port: int) -> bytes:
    with (
        socket.create_connection((host, port)) as plain,
        client_context().wrap_socket(plain, server_hostname=host) as tls,
    ):
        return tls.getpeercert(binary_form=True) or b""


@asynccontextmanager
async def tls_relay(cert: Path, **limits: int) -> AsyncIterator[tuple[Relay, int]]:
    """A relay with a certificate, and its port."""
    config = RelayConfig(port=0, tls_cert=cert, tls_key=key_of(cert), limits=LimitsConfig(**limits))
    async with Relay(config) as relay, asyncio.timeout(30):
        yield relay, int(relay.url.rpartition(":")[2])


@pytest.mark.asyncio
async def test_new_connections_get_the_new_certificate_and_a_call_goes_on(
    cert: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = shutil.copy(cert, tmp_path / "old.pem")
    monkeypatch.setenv("SSL_CERT_FILE", str(old))

    joined: asyncio.Queue[str] = asyncio.Queue()

    def note(event: object, now: float) -> None:
        if isinstance(event, Joined):
            joined.put_nowait(event.peer_id)

    async with tls_relay(cert) as (relay, port):
        assert relay.url.startswith("wss://127.0.0.1:")
        link = Link(LinkConfig(url=relay.url, room="r"), on_event=note)
        running = asyncio.create_task(link.run())
        await joined.get()
        renewed = write_certificate(tmp_path, "renewed")
        relay.tls = loaded(renewed, key_of(renewed))
        served = await asyncio.to_thread(served_certificate, "127.0.0.1", port)
        assert served == ssl.PEM_cert_to_DER_cert(renewed.read_text())
        monkeypatch.setenv("SSL_CERT_FILE", str(renewed))
        websocket = await open_websocket(relay.url)
        assert bound_tls_buffer(websocket.transport)
        assert sslproto.SSLProtocol.max_size <= 32_768  # what each connection sets aside
        await websocket.close()
        assert link.is_joined
        assert link.reconnects == 0
        link.leave()
        await running


@pytest.mark.asyncio
async def test_whom_a_client_does_not_trust_it_does_not_join(
    cert: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SSL_CERT_FILE", str(write_certificate(tmp_path, "other")))
    async with tls_relay(cert) as (relay, _):
        with pytest.raises(RelayRefusedError, match=r"its certificate is not trusted: "):
            await Link(LinkConfig(url=relay.url, room="r")).run()


def page_asked_for_with_the_last_of_the_handshake(port: int) -> bytes:
    """Ask for a page in one piece with the end of the handshake, and return the answer."""
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    tls = client_context().wrap_bio(incoming, outgoing)
    with socket.create_connection(("127.0.0.1", port), 5) as plain:
        while True:
            try:
                tls.do_handshake()
                break
            except ssl.SSLWantReadError:
                plain.sendall(outgoing.read())
                incoming.write(plain.recv(65_536))
        tls.write(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
        plain.sendall(outgoing.read())
        while data := plain.recv(65_536):
            incoming.write(data)
            try:
                return tls.read(65_536)
            except ssl.SSLWantReadError:
                continue
    return b""


@pytest.mark.asyncio
async def test_what_comes_with_the_end_of_the_handshake_is_not_lost(cert: Path) -> None:
    async with tls_relay(cert) as (_, port):
        page = await asyncio.to_thread(page_asked_for_with_the_last_of_the_handshake, port)
        assert page.startswith(b"HTTP/1.1 200 OK")


@pytest.mark.asyncio
async def test_sockets_in_a_tls_handshake_are_counted_and_free_their_places(
    cert: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SSL_CERT_FILE", str(cert))
    async with tls_relay(cert, handshakes=2) as (relay, port):
        silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2)]
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        with suppress(ConnectionResetError):
            assert await reader.read() == b""  # cut without a word of TLS
        assert relay.stats()["limits_hit"] == {"sockets": 1}
        silent[0][1].transport.abort()
        silent[1][1].write(b"no TLS at all")
        with suppress(ConnectionResetError):
            await silent[1][0].read()
        websocket = await open_websocket(relay.url)
        await websocket.close()
        for each in (writer, silent[1][1]):
            each.transport.abort()
