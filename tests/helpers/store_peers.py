"""A relay with a store on loopback, and those who use it, well or badly. On a real clock: the store
works in threads."""

import asyncio
import hashlib
import json
import struct
import time
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from pica_protocol.codec import MAX_CHUNK_BYTES, decode_message, encode_chunk, encode_message
from pica_protocol.messages import STORE_SUBPROTOCOL, Bye, Offer, Stored
from pica_server.config import RelayConfig, StoreConfig
from pica_server.relay import Relay


def fake_avatar(size: int = 40_000, *, seed: int = 0) -> bytes:
    """Bytes with the layout of an avatar file, and nothing of an avatar in them."""
    tensor = {"dtype": "U8", "shape": [size], "data_offsets": [0, size]}
    text = json.dumps({"__metadata__": {"pica": "{}"}, "numbers": tensor}).encode()
    noise = hashlib.shake_128(seed.to_bytes(4, "big")).digest(size)
    return struct.pack("<Q", len(text)) + text + noise


def id_of(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


@asynccontextmanager
async def store_relay(
    where: str | Path = "temporary",
    *,
    config: dict[str, Any] | None = None,
    unix_time: Callable[[], float] = time.time,
    **store: Any,
) -> AsyncIterator[Relay]:
    """Run a relay; ``store`` are limits of its store."""
    limits = StoreConfig(**store)
    settings = RelayConfig(port=0, avatar_store=str(where), store=limits, **(config or {}))
    async with Relay(settings, unix_time=unix_time) as relay:
        yield relay


@asynccontextmanager
async def store_socket(relay: Relay) -> AsyncIterator[ClientConnection]:
    async with connect(
        relay.url, subprotocols=[Subprotocol(STORE_SUBPROTOCOL)], compression=None, proxy=None
    ) as websocket:
        yield websocket


@dataclass(frozen=True)
class Outcome:
    """How an upload ended."""

    code: int | None
    reason: str
    stored: Stored | None = None


def chunks_of(data: bytes) -> list[bytes]:
    starts = range(0, len(data), MAX_CHUNK_BYTES)
    return [encode_chunk(data[at : at + MAX_CHUNK_BYTES]) for at in starts]


async def upload(relay: Relay, data: bytes, *, token: str = "", **offer: Any) -> Outcome:
    """Upload as a good client does; ``offer`` changes what is said of the file."""
    said = Offer(**{"sha256": id_of(data), "size": len(data), "token": token, **offer})
    return await talk(relay, [encode_message(said), *chunks_of(data)])


async def talk(relay: Relay, messages: Iterable[bytes | str]) -> Outcome:
    """Say all of it without listening, and then listen to the end."""
    stored: Stored | None = None
    async with store_socket(relay) as websocket:
        try:
            for message in messages:
                await websocket.send(message)
        except ConnectionClosed:
            pass  # why, is still to be read
        try:
            while True:
                data = await websocket.recv()
                assert isinstance(data, bytes)
                match decode_message(data):
                    case Stored() as stored:
                        pass
                    case Bye(code=code, reason=reason):
                        await websocket.wait_closed()
                        assert (websocket.close_code, websocket.close_reason) == (code, reason)
        except ConnectionClosed:
            pass
        return Outcome(websocket.close_code, websocket.close_reason or "", stored)


@dataclass(frozen=True)
class Reply:
    """An HTTP answer; header names in lower case."""

    status: int
    headers: dict[str, str]
    body: bytes


async def ask(relay: Relay, path: str, *, method: str = "GET", **headers: str) -> Reply:
    """Ask by HTTP, byte by byte: a library would mend what we want to see."""
    host, _, port = relay.url.removeprefix("ws://").rpartition(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    try:
        lines = [f"{method} {path} HTTP/1.1", f"Host: {host}"]
        lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
        writer.write("\r\n".join([*lines, "", ""]).encode())
        answer = await reader.read()
    finally:
        writer.close()
        await writer.wait_closed()
    head, _, body = answer.partition(b"\r\n\r\n")
    status_line, *rest = head.decode().split("\r\n")
    found = dict(line.lower().split(": ", 1) for line in rest)
    assert len(found) == len(rest), "a header came twice"
    return Reply(int(status_line.split()[1]), found, body)


async def until(condition: Callable[[], object]) -> None:
    """Wait until something is so."""
    for _ in range(20_000):
        if condition():
            return
        await asyncio.sleep(0.001)
    raise AssertionError("it did not happen")


async def until_counted(relay: Relay, what: str) -> None:
    """Wait until the store has counted something."""
    await until(lambda: relay.stats()["store"].get(what))


def left_in(folder: Path) -> set[str]:
    """Names below a folder that are no folders."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
