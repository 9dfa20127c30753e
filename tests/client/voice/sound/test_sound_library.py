"""A sound library that cannot be imported, for two threads at once."""

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from pica_client.errors import VoiceError
from pica_client.voice.sound.devices import microphones, speakers

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
