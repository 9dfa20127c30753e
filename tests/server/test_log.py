"""The log: its form, its limit, and what must never stand in it."""

import asyncio
import errno
import io
import json
import logging
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from pica_protocol import SUBPROTOCOL
from pica_protocol.frames import Frame
from pica_protocol.messages import Whisper
from pica_server.log import LINES_AT_ONCE, MOST_WAITING, Style, logging_to, say
from pica_server.tokens import Admission, load_keys, mint, new_key_line
from simnet.peers import FACE, peer_in_room

pytestmark = pytest.mark.call

OURS = logging.getLogger("pica_server.example")
THEIRS = logging.getLogger("library.example")


class Logged:
    """What is logged inside the block."""

    def __init__(self, style: Style = "json") -> None:
        self.stream = io.StringIO()
        self.now = 0.0
        self._context = logging_to(self.stream, style, lambda: self.now)

    def __enter__(self) -> "Logged":
        self._context.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._context.__exit__(None, None, None)

    @property
    def lines(self) -> list[str]:
        return self.stream.getvalue().splitlines()

    @property
    def events(self) -> list[dict[str, object]]:
        return [json.loads(line) for line in self.lines]


def test_a_json_line_has_time_level_event_and_fields() -> None:
    with Logged() as log:
        OURS.info("connection closed", extra={"connection": 3, "code": 1000})
    (event,) = log.events
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", str(event.pop("time")))
    assert event == {"level": "info", "event": "connection closed", "connection": 3, "code": 1000}


def test_what_the_command_says_is_a_sentence_for_people_and_an_event_for_machines() -> None:
    with Logged(style="text") as text, Logged(style="json") as log:
        say(OURS, "listening", "listening on ws://relay", url="ws://relay")
    assert text.lines == ["listening on ws://relay"]
    assert (log.events[0]["event"], log.events[0]["url"]) == ("listening", "ws://relay")


def test_an_error_is_logged_by_type_and_place_and_not_by_its_words() -> None:
    with Logged() as log:
        try:
            raise ValueError("secret words")
        except ValueError:
            OURS.exception("connection failed")
    (event,) = log.events
    assert event["error"] == "ValueError"
    assert str(event["where"]).startswith("['test_log.py:")
    assert "secret" not in log.stream.getvalue()


def test_what_other_libraries_say_is_not_repeated() -> None:
    with Logged() as log:
        THEIRS.error("peer %s sent %r", "203.0.113.7", b"secret", extra={"name_of": "Ada"})
    assert log.events[0]["event"] == "message of library.example"
    assert "secret" not in log.stream.getvalue()
    assert "Ada" not in log.stream.getvalue()


@pytest.mark.parametrize(("logger", "level"), [(OURS, logging.INFO), (THEIRS, logging.WARNING)])
def test_a_flood_of_lines_is_cut_and_counted_and_our_warnings_come_through(
    logger: logging.Logger, level: int
) -> None:
    with Logged() as log:
        for _ in range(int(LINES_AT_ONCE) + 50):
            logger.log(level, "connection closed")
        OURS.warning("something else")
        log.now = 60.0
        OURS.info("connection closed")
    assert len(log.lines) == LINES_AT_ONCE + 2
    assert log.events[-2]["left_out"] == 50
    assert "left_out" not in log.events[-1]


ROOM, NAME, OTHER_NAME = "room-of-requirement", "Hermione", "Ronald"
PAYLOAD, WHISPERED = b"payload-of-a-face", b"whispered-key"
FORWARDED = "203.0.113.77"


def test_no_participant_can_be_found_in_the_log_of_a_relay(tmp_path: Path) -> None:
    """A call with tokens, bad joins, garbage, a flood and a lost peer; then the log is searched."""
    key_file = tmp_path / "keys"
    key_file.write_text(new_key_line())
    keys = load_keys(key_file)

    def token(identity: str) -> str:
        admission = Admission(identity=identity)
        return mint(keys, ROOM, admission, now=time.time(), lasts_s=60)

    face = replace(FACE, avatar="")
    tokens = [token("severus"), token("albus")]

    async def misbehave(url: str, data: bytes | str) -> None:
        headers = {"X-Forwarded-For": FORWARDED}
        pica = [SUBPROTOCOL]
        async with connect(
            url,
            subprotocols=pica,
            proxy=None,
            additional_headers=headers,  # type: ignore[arg-type]
        ) as websocket:
            with suppress(ConnectionClosed):
                await websocket.send(data)
                await websocket.recv()

    async def call(url: str) -> None:
        async with (
            peer_in_room(url, NAME, room=ROOM, tracks=(face,), token=tokens[0]) as ada,
            peer_in_room(url, OTHER_NAME, room=ROOM, tracks=(face,), token=tokens[1]) as bob,
        ):
            await ada.send_frame(PAYLOAD)
            await bob.until(Frame)
            ada.session.tell(Whisper(peer_id=str(bob.session.peer_id), data=WHISPERED))
            await ada.flush()
            await bob.until(Whisper)
            await misbehave(url, b"\x01" + PAYLOAD)
            await misbehave(url, PAYLOAD.decode())
            async with peer_in_room(url, NAME, room=ROOM, token="forged-token"):
                pass
            for _ in range(30):
                await ada.send_frame(bytes(1000))
            bob.websocket.transport.abort()

    arguments = "--port 0 --log json --trusted-proxies 127.0.0.1 "
    arguments += f"--limits.bytes-per-s 4096 --keys {key_file}"
    relay = subprocess.Popen(
        [sys.executable, "-m", "pica_command", "relay", *arguments.split()],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert relay.stderr is not None
        first = relay.stderr.readline()
        url = re.search(r"ws://[0-9.:]+", first)
        assert url is not None, first + relay.stderr.read()
        asyncio.run(call(url[0]))
        relay.send_signal(signal.SIGTERM)
        _, log = relay.communicate(timeout=60)
    finally:
        if relay.poll() is None:
            relay.kill()
            relay.communicate()
    assert relay.returncode == 0, log
    assert log.count("connection closed") == 2, log
    assert "4008" in log  # the flood
    for secret in (
        ROOM, NAME, OTHER_NAME, FORWARDED, "severus", "albus", "forged-token", "127.0.0.1",
        PAYLOAD.decode(), WHISPERED.decode(), *tokens, *(one.rpartition(".")[2] for one in tokens),
    ):  # fmt: skip
        assert secret not in log, secret
    events = [json.loads(line) for line in log.splitlines()]
    assert all({"time", "level", "event"} <= set(event) for event in events)


def test_a_full_disk_stops_nothing_but_the_log() -> None:
    class Full(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    with logging_to(Full(), "json", lambda: 0.0):
        OURS.warning("lost")


def test_lines_that_were_dropped_are_told_of_when_it_flows_again() -> None:
    class Stuck(io.StringIO):
        is_stuck, flows = threading.Event(), threading.Event()

        def write(self, text: str) -> int:
            self.is_stuck.set()
            self.flows.wait()
            return super().write(text)

    stream = Stuck()
    with logging_to(stream, "json", lambda: 0.0):
        OURS.warning("stuck")
        stream.is_stuck.wait()
        for _ in range(MOST_WAITING + 10):
            OURS.warning("waits")
        stream.flows.set()
        while len(stream.getvalue().splitlines()) <= MOST_WAITING:
            time.sleep(0.001)
        OURS.warning("flows")
    last = json.loads(stream.getvalue().splitlines()[-1])
    assert (last["event"], last["left_out"]) == ("flows", 10)
