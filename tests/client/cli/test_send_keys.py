"""What the keys of `pica send` do, on a real terminal."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.toy import make_toy_avatar
from pica_client.cli.send import SendKeys
from pica_client.publish.face_controls import FaceControls
from pica_client.publish.publisher import Publisher, SenderConfig
from pica_client.sources import open_source
from pica_client.sources.live.calibration import CalibrationStore
from pica_client.voice.publisher import VoicePublisher
from pica_client.voice.source import open_voice

pty = pytest.importorskip("pty")
termios = pytest.importorskip("termios")
pytestmark = pytest.mark.unit


@pytest.fixture
def controls(tmp_path: Path) -> Iterator[FaceControls]:
    source = "performance:talk"
    publisher = Publisher(SenderConfig(), open_source(source), make_toy_avatar(), "5" * 64)
    controls = FaceControls(publisher, "Ada", source, CalibrationStore(tmp_path))
    yield controls
    controls.close()


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """The user's side and the program's side of a terminal."""
    user, program = pty.openpty()
    yield user, program
    os.close(user)
    os.close(program)


def test_each_key_does_what_the_help_says(
    controls: FaceControls, capsys: pytest.CaptureFixture[str]
) -> None:
    source = open_voice("speech")
    assert source is not None
    voice = VoicePublisher(source)
    left: list[bool] = []
    keys = SendKeys(controls, voice, lambda: left.append(True))
    modes = []
    for key in "mMmtkx":
        keys.press(key, 0.0)
        modes.append(controls.publisher.mode)
    assert modes[:3] == ["muted", "sent", "muted"]
    assert voice.is_muted
    assert capsys.readouterr().err.splitlines()[-1] == "your voice is muted"
    assert controls.take_notices(0.1) == [
        "Only a tracker is calibrated: choose one in the settings"
    ]
    assert not left
    keys.press("q", 0.0)
    assert left
    SendKeys(controls, None, left.clear).press("t", 0.0)
    assert capsys.readouterr().err == "no voice is sent: see --voice\n"


def test_keys_of_a_terminal_work_at_once_and_it_is_left_as_it_was(
    controls: FaceControls, terminal: tuple[int, int]
) -> None:
    user, program = terminal
    before = termios.tcgetattr(program)

    async def press() -> None:
        left = asyncio.Event()
        async with SendKeys(controls, None, left.set).read(program):
            os.write(user, b"mq")  # without Enter
            async with asyncio.timeout(10):
                await left.wait()

    asyncio.run(press())
    assert controls.publisher.mode == "muted"
    assert termios.tcgetattr(program) == before


def test_keys_typed_for_another_job_are_not_read(
    controls: FaceControls, terminal: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    user, program = terminal
    is_behind = True
    monkeypatch.setattr("pica_client.cli.send._is_in_background", lambda terminal: is_behind)

    async def press() -> None:
        nonlocal is_behind
        left = asyncio.Event()
        async with SendKeys(controls, None, left.set).read(program):
            os.write(user, b"m\n")
            await asyncio.sleep(0.3)
            assert os.read(program, 8) == b"m\n"  # as the shell does
            is_behind = False  # fg
            await asyncio.sleep(0.3)
            os.write(user, b"m")
            await asyncio.sleep(0.3)
            assert controls.publisher.mode == "muted"
            is_behind = True  # Ctrl-Z and bg
            os.write(user, b"q")
            await asyncio.sleep(0.3)
            assert not left.is_set()

    asyncio.run(press())


def test_a_pipe_has_no_keys(controls: FaceControls, capsys: pytest.CaptureFixture[str]) -> None:
    reader, writer = os.pipe()

    async def read() -> None:
        async with SendKeys(controls, None, lambda: None).read(reader):
            pass

    asyncio.run(read())
    os.close(reader)
    os.close(writer)
    assert capsys.readouterr().err == ""
