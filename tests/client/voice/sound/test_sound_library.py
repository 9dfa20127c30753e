"""A sound library that cannot be imported, for two threads at once; times of a microphone."""

import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pica_client.errors import VoiceError
from pica_client.voice.opus import FRAME_S, SAMPLE_RATE_HZ
from pica_client.voice.sound import devices
from pica_client.voice.sound.devices import Microphone, microphones, speakers

pytestmark = pytest.mark.unit


def test_both_threads_are_told_that_there_is_no_sound_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = "import time\ntime.sleep(0.1)\nraise AssertionError\n"
    (tmp_path / "soundcard.py").write_text(slow)
    monkeypatch.delitem(sys.modules, "soundcard", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with ThreadPoolExecutor(2) as pool:
        asked = [pool.submit(ask) for ask in (speakers, microphones)]
        troubles = [each.exception() for each in asked]
    assert [type(each) for each in troubles] == [VoiceError, VoiceError]
    assert all("no server answers" in str(each) for each in troubles)


class Stream:
    """A microphone that is open, on a clock of its own: each frame takes 20 ms of it."""

    latency = 0.12

    def __init__(self) -> None:
        self.now = 100.0

    def record(self, count: int) -> np.ndarray:
        self.now += count / SAMPLE_RATE_HZ
        time.sleep(0)  # the other threads, too, have a turn
        return np.zeros((count, 1), np.float32)

    def __exit__(self, *_: object) -> None:
        """It is closed."""


@pytest.fixture
def stream(monkeypatch: pytest.MonkeyPatch) -> Stream:
    """That of "there", the only microphone."""
    stream = Stream()
    there = SimpleNamespace(name="there", recorder=lambda *_, **__: nullcontext(stream))
    card = SimpleNamespace(all_microphones=lambda: [there], default_microphone=lambda: there)
    monkeypatch.setattr(devices, "_soundcard", lambda: card)
    monkeypatch.setattr(devices, "time", SimpleNamespace(monotonic=lambda: stream.now))
    return stream


def test_each_frame_that_is_given_says_when_it_was_captured(stream: Stream) -> None:
    times_s, enough = [], threading.Event()

    def take(_: np.ndarray, captured_us: int) -> None:
        times_s.append((captured_us / 1e6, stream.now))
        if len(times_s) == 100:
            enough.set()

    microphone = Microphone(take, "there")
    microphone.start()
    assert enough.wait(20)
    microphone.stop()
    captured_s, given_s = np.transpose(times_s)
    np.testing.assert_allclose(captured_s, given_s - FRAME_S - Stream.latency, atol=1e-5)
