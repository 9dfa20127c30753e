"""Recordings: playable, at the times the frames were drawn."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pica_client.errors import OptionError
from pica_client.ui.recorder import KEY_FRAMES, Recorder, Soundtrack, new_path
from pica_client.voice.opus import FRAME_SAMPLES, SAMPLE_RATE_HZ

av = pytest.importorskip("av")
pytestmark = pytest.mark.unit


def grey(level: int, size: tuple[int, int] = (64, 48)) -> np.ndarray:
    return np.full((size[1], size[0], 4), level, np.uint8)


def frames_of(path: Path) -> list[tuple[float, np.ndarray]]:
    """Times and grey pictures."""
    with av.open(str(path)) as container:
        return [
            (float(frame.pts * frame.time_base), frame.to_ndarray(format="gray"))
            for frame in container.decode(video=0)
        ]


def test_frames_keep_their_times_and_brightness_at_a_rate_that_players_know(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mp4", (64, 48)) as recorder:
        for time_s, level in ((0.0, 50), (0.0002, 60), (0.033, 100), (0.5, 150), (0.533, 200)):
            recorder.write(grey(level), time_s)
    frames = frames_of(tmp_path / "a.mp4")
    assert [time_s for time_s, _ in frames] == pytest.approx([0, 0.033, 0.5, 0.533], abs=9e-3)
    levels = [int(frame.mean()) for _, frame in frames]
    assert levels == sorted(levels)
    assert levels[-1] - levels[0] > 100
    with av.open(str(tmp_path / "a.mp4")) as container:
        assert container.streams.video[0].base_rate in (30, 60)


def test_a_window_of_another_size_is_recorded_whole(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mp4", (64, 48)) as recorder:
        for index, (width, height) in enumerate(((128, 96), (32, 24), (256, 48))):
            image = grey(60, (width, height))
            image[:, width // 2 :] = 220
            recorder.write(image, index / 10)
    places = ((0, 48), (0, 48), (18, 30))
    for (_, frame), (top, bottom) in zip(frames_of(tmp_path / "a.mp4"), places, strict=True):
        shown = frame[top + 2 : bottom - 2].astype(int)
        assert np.abs(shown[:, 2:28] - 60).max() < 20
        assert np.abs(shown[:, 36:62] - 220).max() < 20
        bars = np.delete(frame, np.s_[max(top - 2, 0) : bottom + 2], axis=0)
        assert bars.size == 0 or bars.max() < 20


def test_a_recording_without_frames_leaves_no_file_and_can_be_closed_twice(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "empty.mp4", (64, 48))
    with pytest.raises(OptionError, match=r"empty\.mp4: no picture was drawn"):
        recorder.close()
    recorder.close()
    assert list(tmp_path.iterdir()) == []


KILLED = """
import os, sys, numpy as np
from pathlib import Path
from pica_client.ui.recorder import Recorder
recorder = Recorder(Path(sys.argv[1]), (64, 48))
for index in range(300):
    recorder.write(np.full((48, 64, 4), index % 200, np.uint8), index / 30)
os._exit(9)
"""


def test_what_was_recorded_before_the_process_was_killed_can_be_played(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    assert subprocess.run([sys.executable, "-c", KILLED, str(path)], timeout=60).returncode == 9
    assert len(frames_of(path)) >= 300 - 2 * KEY_FRAMES - 20


def test_names_count_up_and_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "call-0001.mp4").write_text("mine")
    assert new_path(tmp_path, "call", ".mp4").name == "call-0002.mp4"
    with pytest.raises(OptionError, match="cannot be written"):
        new_path(tmp_path / "call-0001.mp4", "call", ".mp4")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a disk that is always full")
@pytest.mark.parametrize("num_frames", [2, 300])
def test_a_full_disk_ends_the_recording_with_its_name(num_frames: int) -> None:
    recorder = Recorder(Path("/dev/full"), (64, 48))
    noise = np.random.default_rng(0).integers(0, 255, (48, 64, 4), np.uint8)

    def record() -> None:
        for index in range(num_frames):
            recorder.write(noise, index / 30)
        recorder.close()

    with pytest.raises(OptionError, match="/dev/full: cannot be written: No space left"):
        record()
    recorder.write(noise, num_frames / 30)
    recorder.close()


def test_sound_is_in_step_with_the_pictures(tmp_path: Path) -> None:
    track, begin_s, seconds, fps = Soundtrack(), 100.0, 4.0, 30
    chance = np.random.default_rng(3)

    def tone(hertz: float, from_s: float, at_s: float) -> np.ndarray:
        times = at_s + np.arange(FRAME_SAMPLES) / SAMPLE_RATE_HZ
        sound = 0.4 * np.sin(2 * np.pi * hertz * times) * (times >= from_s)
        return sound.astype(np.float32)

    path = tmp_path / "call.mp4"
    with Recorder(path, (64, 48), lambda: track) as recorder:
        sent = 0
        for picture in range(round(seconds * fps)):
            now = begin_s + picture / fps
            shade = 255 if 101.0 <= now < 102.0 else 0
            recorder.write(np.full((48, 64, 4), shade, np.uint8), now)
            while (at_s := begin_s + 0.02 * sent) < now + 0.1:
                sent += 1
                both = np.stack([tone(1000.0, 101.0, at_s)] * 2, axis=1)
                # A loudspeaker takes its frames early or late; what is sent comes after its time.
                track.add("others", both, at_s + chance.uniform(-0.01, 0.01))
                track.add("own", tone(440.0, 102.5, at_s - 0.04), at_s - 0.04)

    with av.open(str(path)) as container:
        frames = list(container.decode(audio=0))
        first_s = frames[0].time
        sound = np.concatenate([frame.to_ndarray()[0] for frame in frames])
        rate = container.streams.audio[0].rate
    flash_s = next(time_s for time_s, frame in frames_of(path) if frame.mean() > 100)
    onset_s = first_s + np.argmax(np.abs(sound) > 0.1) / rate
    assert abs(onset_s - flash_s) <= 1 / fps
    assert first_s + len(sound) / rate == pytest.approx(seconds, abs=1 / fps)
    for begin, end, peaks in ((1.2, 2.2, {1000}), (2.8, 3.8, {440, 1000})):
        piece = sound[round(begin * rate) : round(end * rate)]
        spectrum = np.abs(np.fft.rfft(piece * np.hanning(len(piece))))
        loud = set(np.flatnonzero(spectrum > 0.5 * spectrum.max()) * rate // len(piece))
        assert {round(hertz, -1) for hertz in map(int, loud)} == peaks
