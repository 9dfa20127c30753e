"""A relay in a process of its own, strangers who do all that `abuse` knows, and a healthy room.

The strangers connect, say what they have to say, and read until the relay closes or has answered
their goodbye; they check all that it sends: frames, messages, close codes, HTTP statuses.
Meanwhile two peers keep up a call through the same relay and must not lose a frame, and
``/healthz`` is asked again and again.
"""

from __future__ import annotations

import asyncio
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Final

from fuzzing.abuse import CLOSE, Conversation, conversation, frame, handshake, http
from helpers.paths import ROOT
from pica_protocol.codec import decode_message, decode_store_message
from pica_protocol.errors import ProtocolError
from pica_protocol.frames import MEDIA_KIND, Frame, decode_media
from simnet.peers import WirePeer, peer_in_room

PROTOCOL_PAGE: Final = ROOT / "docs" / "protocol.md"
STATUSES: Final = frozenset(
    {101, 200, 206, 304, 400, 403, 404, 405, 414, 416, 426, 431, 501, 503, 505}
)
"""What the relay, or the library under it, may answer by HTTP. No 500: that is a fault of ours."""
MOST_GROWTH_MIB: Final = 64.0
"""What the relay's resident memory may grow by, with a few dozen strangers at a time (chosen: each
has a handshake of 16 KiB or some messages of 16 KiB; the rest is the allocator's)."""
_TROUBLE: Final = re.compile(r"\S+ (warning|error|critical) |Traceback")
"""In the relay's log: what its operator would have to look at."""
LONGEST_ANSWER_S: Final = 15.0
FPS: Final = 30.0


class LiveFailure(Exception):
    """The relay did something that is not documented."""


def documented_codes() -> frozenset[int]:
    """Read the table of close codes in docs/protocol.md."""
    page = PROTOCOL_PAGE.read_text().partition("## Close codes")[2].partition("\n## ")[0]
    return frozenset(int(code) for code in re.findall(r"^\| (\d{4}) \|", page, re.MULTILINE))


@contextmanager
def relay_process(*arguments: str) -> Iterator[tuple[int, int]]:
    """Run a relay; yields its process id and its port, and ends that process.

    Raises:
        LiveFailure: It does not start, ends by itself or badly, or has logged a warning: nothing
            that a peer does is worth one, so none may fill the log with them.
    """
    # Many joins from one machine: it is to see more than the refusal to let so many in at once.
    limits = ["--limits.joins-per-s", "1e6", "--limits.joins-burst", "1e6"]
    with tempfile.TemporaryFile("w+") as log:  # a pipe that nobody reads would stop it
        process = subprocess.Popen(
            [sys.executable, "-m", "pica_command", "relay", "--port", "0", *limits, *arguments],
            stdout=subprocess.DEVNULL,
            stderr=log,
        )
        try:
            yield process.pid, _port(process, log)
            if process.poll() is not None:
                raise LiveFailure(f"the relay ended by itself: {_lines(log)[-5:]}")
        finally:
            process.terminate()
            try:
                process.wait(timeout=30)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        lines = [line for line in _lines(log) if _TROUBLE.match(line)]
        if process.returncode != 0 or lines:
            said = f"{len(lines)} lines, as {lines[:3]}"
            raise LiveFailure(f"it ended with {process.returncode} and said {said}")


def _port(process: subprocess.Popen[bytes], log: IO[str]) -> int:
    """Wait until it listens."""
    for _ in range(600):
        for line in _lines(log):
            found = re.match(r"listening on ws://127\.0\.0\.1:(\d+)", line)
            if found is not None:
                return int(found[1])
        if process.poll() is not None:
            break
        time.sleep(0.05)
    raise LiveFailure(f"no relay: {_lines(log)}")


def _lines(log: IO[str]) -> list[str]:
    return os.pread(log.fileno(), 10_000_000, 0).decode(errors="replace").splitlines()


def memory_mib(pid: int, field: str = "VmRSS") -> float:
    """Return the resident memory of a process, or its peak (``VmHWM``); 0 where it is not known."""
    status = Path(f"/proc/{pid}/status")
    if not status.exists():
        return 0.0
    found = re.search(rf"{field}:\s+(\d+) kB", status.read_text())
    return int(found[1]) / 1024 if found else 0.0


class Strangers:
    """Several tasks that connect again and again until enough has been sent.

    Attributes:
        num_damaged: Sent so far: damaged messages, odd requests and pieces of abuse.
        num_whole: Good messages in between.
        codes: Close codes that the relay has sent; 0: cut without one.
        statuses: HTTP answers.
        failures: What was not documented.
    """

    def __init__(self, port: int, num_messages: int, seed: int) -> None:
        self._port = port
        self._wanted = num_messages
        self._seed = seed
        self._known = documented_codes()
        self.num_damaged = 0
        self.num_whole = 0
        self.num_connections = 0
        self.codes: Counter[int] = Counter()
        self.statuses: Counter[int] = Counter()
        self.failures: list[str] = []

    async def run(self, worker: int) -> None:
        """Be one stranger after the other."""
        turn = 0
        while self.num_damaged < self._wanted and not self.failures:
            rng = random.Random(f"{self._seed}:{worker}:{turn}")
            where = f"(seed {self._seed}, worker {worker}, turn {turn})"
            try:
                async with asyncio.timeout(LONGEST_ANSWER_S):
                    await self._visit(rng)
            except TimeoutError:
                self.failures.append(f"no end within {LONGEST_ANSWER_S:g} s {where}")
            except LiveFailure as failure:
                self.failures.append(f"{failure} {where}")
            turn += 1

    async def _visit(self, rng: random.Random) -> None:
        self.num_connections += 1
        reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
        try:
            if rng.random() < 0.25:
                self.num_damaged += 1
                await self._ask(rng, reader, writer)
            else:
                talk = conversation(rng)
                self.num_damaged += talk.num_damaged
                self.num_whole += talk.num_whole
                await self._talk(rng, talk, reader, writer)
        except ConnectionError:
            self.codes[0] += 1
        finally:
            writer.transport.abort()

    async def _ask(
        self, rng: random.Random, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Write a request of some kind, and look at the answer, if there is one."""
        writer.write(http(rng))
        answer = b""
        try:
            async with asyncio.timeout(0.25):
                answer = await _head(reader)
        except TimeoutError:  # it waits for the rest; most of us do not
            if rng.random() < 0.95:
                writer.write_eof()
            answer = await _head(reader)
        if not answer:
            self.codes[0] += 1
            return
        # A ping in one piece with the request, too early, is answered before the request is.
        found = re.match(rb"(?:\x8a[\x00-\x7d][^H]*)*HTTP/1\.1 (\d{3}) ", answer)
        if found is None:
            raise LiveFailure(f"an answer that is no HTTP: {answer[:100]!r}")
        self._note_status(int(found[1]))

    async def _talk(
        self,
        rng: random.Random,
        talk: Conversation,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        writer.write(handshake(rng, talk.protocol))
        head = await reader.readuntil(b"\r\n\r\n")
        status = int(head.split(b" ", 2)[1])
        self._note_status(status)
        if status != 101:
            return
        if b"deflate" in head.lower():
            raise LiveFailure("it agrees to compress")
        for piece in talk.pieces:
            writer.write(piece)
            if rng.random() < 0.1:
                await asyncio.sleep(0)
        if rng.random() < 0.1:
            return  # gone without a word
        writer.write(frame((1000).to_bytes(2), opcode=CLOSE))
        talk.codes.add(1000)
        if not talk.is_whole:
            # The relay may wait for the rest of something for ever; it need not.
            with suppress(ConnectionError):
                writer.write_eof()
        await self._listen(talk, reader)

    async def _listen(self, talk: Conversation, reader: asyncio.StreamReader) -> None:
        """Read until the end, and check all that comes."""
        code = 0
        try:
            while True:
                first, second = await reader.readexactly(2)
                if first & 0x70 or second & 0x80 or not first & 0x80:
                    raise LiveFailure(f"a frame that no relay sends: {first:#x} {second:#x}")
                size = second & 0x7F
                if size > 125:
                    size = int.from_bytes(await reader.readexactly(2 if size == 126 else 8))
                payload = await reader.readexactly(size)
                match first & 0x0F:
                    case 2:
                        _check_message(talk.protocol, payload)
                    case 8:
                        code = int.from_bytes(payload[:2]) if payload else 1005
                    case 9 | 10:
                        pass
                    case opcode:
                        raise LiveFailure(f"a frame of kind {opcode}")
        except (asyncio.IncompleteReadError, ConnectionError):
            self.codes[code] += 1
        if code and code not in self._known and code not in talk.codes:
            raise LiveFailure(f"closed with {code}, which nobody documents")

    def _note_status(self, status: int) -> None:
        self.statuses[status] += 1
        if status not in STATUSES:
            raise LiveFailure(f"HTTP {status}")


async def _head(reader: asyncio.StreamReader) -> bytes:
    """Read the head of an HTTP answer, or what there is of it."""
    try:
        return await reader.readuntil(b"\r\n\r\n")
    except asyncio.IncompleteReadError as error:
        return error.partial


def _check_message(protocol: str, data: bytes) -> None:
    try:
        if data[:1] == bytes([MEDIA_KIND]):
            decode_media(data)
        elif protocol == "pica.store.1":
            decode_store_message(data)
        else:
            decode_message(data)
    except ProtocolError as error:
        raise LiveFailure(f"the relay sent what no client reads: {error}") from error


@asynccontextmanager
async def healthy_call(url: str) -> AsyncIterator[tuple[WirePeer, WirePeer]]:
    """Two peers in a room of their own, one of whom publishes all the while."""
    async with (
        peer_in_room(url, "Ada", room="healthy") as ada,
        peer_in_room(url, "Bob", room="healthy") as bob,
    ):
        publishing = asyncio.create_task(ada.publish(10**9, FPS))
        try:
            yield ada, bob
        finally:
            publishing.cancel()
            await asyncio.gather(publishing, return_exceptions=True)


async def _status(port: int, path: str) -> tuple[int, bytes]:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        answer = await reader.read()
        return int(answer.split(b" ", 2)[1]), answer.partition(b"\r\n\r\n")[2]
    finally:
        writer.transport.abort()


async def _watch_health(port: int, seen: Counter[int]) -> None:
    while True:
        status, _ = await _status(port, "/healthz")
        seen[status] += 1
        await asyncio.sleep(0.25)


async def _besiege(
    pid: int, port: int, num_messages: int, *, seed: int, num_workers: int
) -> dict[str, Any]:
    strangers = Strangers(port, num_messages, seed)
    health: Counter[int] = Counter()
    begin_s = time.monotonic()
    async with healthy_call(f"ws://127.0.0.1:{port}") as (ada, bob):
        await bob.until(Frame)
        memory_before = memory_mib(pid)
        watching = asyncio.create_task(_watch_health(port, health))
        await asyncio.gather(*(strangers.run(worker) for worker in range(num_workers)))
        took_s = time.monotonic() - begin_s
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
        await asyncio.sleep(0.5)
        sequences = [each.sequence for _, each in bob.arrivals]
        num_lost = (sequences[-1] - sequences[0]) % 65_536 + 1 - len(sequences)
        gaps = [b - a for (a, _), (b, _) in zip(bob.arrivals, bob.arrivals[1:], strict=False)]
        closed = (ada.session.closed, bob.session.closed)
        memory_peak = memory_mib(pid, "VmHWM")
        last_status, _ = await _status(port, "/healthz")
    failures = list(strangers.failures)
    if num_lost or closed != (None, None):
        failures.append(f"the healthy room lost {num_lost} frames; its peers ended with {closed}")
    if set(health) - {200} or last_status != 200:
        failures.append(f"/healthz answered {dict(health)} and then {last_status}")
    if memory_peak - memory_before > MOST_GROWTH_MIB:
        failures.append(f"its memory grew from {memory_before:.0f} to {memory_peak:.0f} MiB")
    if failures:
        raise LiveFailure("; ".join(failures))
    return {
        "damaged": strangers.num_damaged,
        "whole": strangers.num_whole,
        "connections": strangers.num_connections,
        "seed": seed,
        "seconds": round(took_s, 1),
        "close_codes": {str(code): num for code, num in sorted(strangers.codes.items())},
        "http_statuses": {str(code): num for code, num in sorted(strangers.statuses.items())},
        "health_checks": health[200],
        "healthy_frames": len(sequences),
        "healthy_lost": num_lost,
        "healthy_longest_gap_ms": round(max(gaps, default=0.0) * 1000, 1),
        "memory_mib_before": round(memory_before, 1),
        "memory_mib_peak": round(memory_peak, 1),
    }


def besiege(num_messages: int, *, seed: int, num_workers: int = 8) -> dict[str, Any]:
    """Let strangers send at least so many damaged messages to a live relay.

    Args:
        num_messages: Damaged messages, odd requests and pieces of abuse.
        seed: Of everything the strangers say; not of the order in which it comes.
        num_workers: Strangers at the same time.

    Returns:
        Figures for people and reports.

    Raises:
        LiveFailure: The relay did something that is not documented, or others suffered from it.
    """
    with relay_process() as (pid, port):
        siege = _besiege(pid, port, num_messages, seed=seed, num_workers=num_workers)
        return asyncio.run(siege)
