"""What a sender without a window is told of its microphone."""

from __future__ import annotations

import sys
from queue import Queue
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pica_client.voice.sound.devices import Microphone
from pica_client.voice.source import open_voice
from pica_command.main import main
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit


class Card:
    """A sound library with one microphone, which is there only at times."""

    def __init__(self) -> None:
        self.has_one = False
        self._one = SimpleNamespace(name="Built-in", recorder=lambda *_, **__: self)

    def default_microphone(self) -> Any:
        if not self.has_one:
            raise IndexError
        return self._one

    def all_microphones(self) -> list[Any]:
        return [self._one]

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def record(self, num_samples: int) -> FloatArray:
        return np.zeros((num_samples, 1), np.float32)


def test_a_sender_is_told_whenever_its_microphone_is_missing_or_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    card, said = Card(), Queue[str]()
    monkeypatch.setitem(sys.modules, "soundcard", card)
    monkeypatch.setattr("pica_client.voice.source.find_spec", lambda name: True)
    monkeypatch.setattr("pica_client.voice.source.say", said.put)
    monkeypatch.setattr("pica_client.voice.sound.devices.RETRY_S", 0.0)
    microphone = open_voice("mic:Desk", cleans=False)
    assert isinstance(microphone, Microphone)
    microphone.start()
    assert said.get(timeout=30) == "no microphone on this machine"
    card.has_one = True
    assert said.get(timeout=30) == "no microphone 'Desk'; 'Built-in' is used"
    microphone.choose("Built-in")
    assert said.get(timeout=30) == "the microphone is there again"
    microphone.stop()


def test_a_sender_without_the_extra_is_told_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "soundcard", None)
    assert main(["send", "--voice", "mic"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("pica send: needs soundcard; install it with: pip install")
