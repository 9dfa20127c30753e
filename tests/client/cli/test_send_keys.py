"""What the keys of `pica send` do, on a real terminal."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.toy import make_toy_avatar
from pica_client.cli.send import SendKeys, read_keys
from pica_client.publish.face_desk import FaceDesk
from pica_client.publish.publisher import Publisher, SenderConfig
from pica_client.sources import open_source
from pica_client.sources.live.calibration import CalibrationStore
from pica_client.voice.publisher import VoicePublisher
from pica_client.voice.source import open_voice

pty = pytest.importorskip("pty")
termios = pytest.importorskip("termios")
pytestmark = pytest.mark.unit


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[FaceDesk]:
    source = "performance:talk"
    publisher = Publisher(SenderConfig(), open_source(source), make_toy_avatar(), "5" * 64)
    desk = FaceDesk(publisher, "Ada", source, CalibrationStore(tmp_path))
    yield desk
    desk.close()


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """The user's side and the program's side of a terminal."""
    user, program = pty.openpty()
    yield user, program
    os.close(user)
    os.close(program)


def test_each_key_does_what_the_help_says(desk: FaceDesk) -> None:
    said: list[str] = []
    source = open_voice("speech")
    assert source is not None
    voice = VoicePublisher(source)
    left: list[bool] = []
    keys = SendKeys(desk, voice, said.append, lambda: left.append(True))
    modes = []
    for key in "mMffm":
        keys.press(key, 0.0)
        modes.append(desk.publisher.mode)
    assert modes == ["muted", "sent", "frozen", "sent", "muted"]
    keys.press("t", 0.0)
    assert voice.is_muted
    assert said[-1] == "your voice is muted"
    keys.press("k", 0.0)
    keys.handle_timer(0.1)
    assert said[-1] == "Only a tracker is calibrated: choose one in the settings"
    keys.press("x", 0.0)
    assert not left
    keys.press("q", 0.0)
    assert left


def test_a_mute_without_a_voice_says_how_to_send_one(desk: FaceDesk) -> None:
    said: list[str] = []
    SendKeys(desk, None, said.append, lambda: None).press("t", 0.0)
    assert said == ["no voice is sent: see --voice"]


def test_keys_of_a_terminal_work_at_once_and_it_is_left_as_it_was(
    desk: FaceDesk, terminal: tuple[int, int]
) -> None:
    user, program = terminal
    before = termios.tcgetattr(program)

    async def press() -> bool:
        heard = asyncio.Event()
        keys = SendKeys(desk, None, lambda line: heard.set(), lambda: None)
        async with read_keys(keys, program) as has_keys:
            os.write(user, b"m")  # without Enter
            async with asyncio.timeout(10):
                await heard.wait()
        return has_keys

    assert asyncio.run(press())
    assert desk.publisher.mode == "muted"
    assert termios.tcgetattr(program) == before


def test_a_pipe_has_no_keys(desk: FaceDesk) -> None:
    reader, writer = os.pipe()

    async def has_keys() -> bool:
        async with read_keys(SendKeys(desk, None, print, lambda: None), reader) as found:
            return found

    assert not asyncio.run(has_keys())
    os.close(reader)
    os.close(writer)
