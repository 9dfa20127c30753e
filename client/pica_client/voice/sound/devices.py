"""Microphone and loudspeaker, each on a thread of its own; a call goes on without them.

SoundCard rather than sounddevice: it speaks to PulseAudio and PipeWire, Core Audio and Windows
itself, so every device has its own name, a new one is found without a restart, and what the
hardware is not (48 kHz, one or two channels) the system converts. PortAudio lists devices once, and
as Debian builds it knows one "pulse" for all.

For a device that is missing or unplugged the system's default takes over, and `DeviceState.note`
says so; it is gone back to once it is there again. Without any device there is another try every
`RETRY_S`; meanwhile voices are pulled all the same, so that their faces go on.
"""

import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np

from pica_client.errors import VoiceError
from pica_client.voice.mixer import VoiceMixer
from pica_client.voice.opus import FRAME_S, FRAME_SAMPLES, MAX_LEVEL, SAMPLE_RATE_HZ, level_of
from pica_client.voice.sound.settings import NO_DEVICE, NO_LIBRARY, DeviceState
from pica_core.types import FloatArray

RETRY_S, AT_ONCE_S = 2.0, 0.1
"""Until the next try where there is no device; and after one was lost in the middle of its work."""
BUFFER_FRAMES = 2
"""Frames that the system keeps for a loudspeaker (chosen: with one, a busy machine crackles)."""
LOST_FRAMES, LOST_RATIO = 10, 0.2
"""A loudspeaker that takes so many frames in less than this share of their time is not there."""
LATENCY_FRAMES = (10, 50)
"""After so many frames a device is asked for its latency, and not again: PulseAudio's library ends
the whole process when it is asked of a device that has just been unplugged."""
EARLY_STEP, LATE_STEP = 0.1, 0.01
"""Shares of an error of the capture clock that are mended with each frame: a frame that comes early
tells the truth, one that comes late mostly that the machine was busy."""
CLOCK_LEAP_S = 1.0
"""An error of the capture clock that is mended at once: the machine slept."""
_IMPORTING = threading.Lock()
NO_SOUND = "no sound system: {}; on Linux start PulseAudio or PipeWire"


def speakers() -> list[str]:
    """The names of all loudspeakers, the default first.

    Raises:
        VoiceError: There is no sound system; names the fix.
    """
    return _names(_soundcard().all_speakers, _soundcard().default_speaker)


def microphones() -> list[str]:
    """The names of all microphones, the default first; see `speakers`."""
    return _names(_soundcard().all_microphones, _soundcard().default_microphone)


class _Device(ABC):
    """A device that is opened again and again, on a thread of its own."""

    def __init__(self, name: str) -> None:
        self.state = DeviceState()
        self._wanted = name
        self._stopping, self._is_changed = threading.Event(), threading.Event()
        self._num_frames = 0
        self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)

    def start(self) -> None:
        """Begin to open the device; twice is once."""
        if self._thread.ident is None:
            self._thread.start()

    def stop(self) -> None:
        """End, and wait for it; twice is once."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    def choose(self, name: str) -> None:
        """Go over to another device, from the next frame; empty: the system's default."""
        if name != self._wanted:
            self._wanted = name
            self._is_changed.set()

    def offer(self, names: Sequence[str]) -> None:
        """Take the list of devices: a wanted one that was missing is gone back to, and one that
        is gone, from which the system has moved us away, is left."""
        name = self.state.name
        is_back = self.state.note and self._wanted in names and self._wanted != name
        if is_back or (name not in ("", NO_DEVICE) and names and name not in names):
            self._is_changed.set()

    def _run(self) -> None:
        stream: Any = None
        retry_s = 0.0
        while not self._stopping.is_set():
            try:
                if self._is_changed.is_set() or (stream is None and time.monotonic() >= retry_s):
                    self._is_changed.clear()
                    before, stream = stream, None
                    if before is not None:
                        before.__exit__(None, None, None)
                    self._num_frames = 0
                    stream, self.state = self._open(self._wanted)
                if stream is None:
                    self._idle()
                else:
                    self._work(stream)
                    self._num_frames += 1
            except Exception as error:  # whatever a sound system throws, the call goes on
                # What is lost is not closed: that would end the process.
                words = str(error) if isinstance(error, VoiceError) else f"sound lost: {error}"
                self.state, stream = DeviceState(note=words), None
                is_lost = self._num_frames > LOST_FRAMES
                retry_s = time.monotonic() + (AT_ONCE_S if is_lost else RETRY_S)
        if stream is not None:
            stream.__exit__(None, None, None)

    def _idle(self) -> None:
        """Pass the time of a frame without a device."""
        self._stopping.wait(FRAME_S)

    def _ask_latency(self, stream: Any) -> None:
        if self._num_frames in LATENCY_FRAMES:  # and it took its time for the last frame
            latency_s = float(getattr(stream, "latency", 0.0))
            if 0 < latency_s < 2:
                self.state = replace(self.state, latency_s=latency_s)

    @abstractmethod
    def _open(self, name: str) -> tuple[Any, DeviceState]: ...

    @abstractmethod
    def _work(self, stream: Any) -> None: ...


class Loudspeaker(_Device):
    """Plays what a mixer mixes.

    Attributes:
        on_played: Is given what goes to the device, float32 ``[FRAME_SAMPLES, 2]``.
    """

    def __init__(self, mixer: VoiceMixer) -> None:
        super().__init__("")
        self.on_played: Callable[[FloatArray], None] | None = None
        self._mixer = mixer
        self._played_s: deque[float] = deque(maxlen=LOST_FRAMES)
        self._nothing = _NoSpeaker()

    def _open(self, name: str) -> tuple[Any, DeviceState]:
        if name == NO_DEVICE:
            return _NoSpeaker(), DeviceState(NO_DEVICE)
        card = _soundcard()
        device, note = _found(name, card.all_speakers, card.default_speaker, "loudspeaker")
        channels = min(device.channels, 2)
        player = device.player(
            SAMPLE_RATE_HZ, channels=channels, blocksize=BUFFER_FRAMES * FRAME_SAMPLES
        )
        stream = player.__enter__()
        # A device that slept takes nothing for a while.
        stream.play(np.zeros((BUFFER_FRAMES * FRAME_SAMPLES, stream.channels), np.float32))
        return stream, DeviceState(device.name, note, BUFFER_FRAMES * FRAME_S)

    def _work(self, stream: Any) -> None:
        times = self._played_s
        if len(times) > 1 and times[-1] - times[-2] > LOST_RATIO * FRAME_S:
            self._ask_latency(stream)
        if self._num_frames == 0:
            times.clear()
        sound = self._next()
        stream.play(sound if stream.channels == 2 else sound.mean(axis=1, keepdims=True))
        times.append(time.monotonic())
        if len(times) == LOST_FRAMES and times[-1] - times[0] < LOST_RATIO * LOST_FRAMES * FRAME_S:
            raise VoiceError(f"loudspeaker {self.state.name!r} is gone")

    def _next(self) -> FloatArray:
        sound = self._mixer.mix(time.monotonic(), self.state.latency_s)
        if self.on_played is not None:
            self.on_played(sound)
        return sound

    def _idle(self) -> None:
        self._nothing.play(self._next())


class _NoSpeaker(nullcontext[None]):
    """Takes sound as fast as a loudspeaker would, and makes none."""

    channels, latency = 2, 0.0

    def __init__(self) -> None:
        super().__init__()
        self._until_s = time.monotonic()

    def play(self, sound: FloatArray) -> None:
        """Wait until the sound would have been taken."""
        self._until_s = max(self._until_s + FRAME_S, time.monotonic() - 10 * FRAME_S)
        time.sleep(max(self._until_s - time.monotonic(), 0.0))


class Microphone(_Device):
    """Captures a voice.

    Attributes:
        clean: Takes each frame through echo cancellation and the like; None: nothing does.
        level: Of the last frame, see `level_of`.
    """

    def __init__(self, on_frame: Callable[[FloatArray, int], None], name: str = "") -> None:
        """Prepare the device of a name, empty for the system's default.

        Args:
            on_frame: Takes 20 ms and when the first of its samples was captured, microseconds.
        """
        super().__init__(name)
        self.clean: Callable[[FloatArray], FloatArray] | None = None
        self.level = MAX_LEVEL
        self._on_frame = on_frame
        self._captured_s: float | None = None

    def _open(self, name: str) -> tuple[Any, DeviceState]:
        card = _soundcard()
        device, note = _found(name, card.all_microphones, card.default_microphone, "microphone")
        recorder = device.recorder(SAMPLE_RATE_HZ, channels=1, blocksize=FRAME_SAMPLES // 2)
        return recorder.__enter__(), DeviceState(device.name, note)

    def _work(self, stream: Any) -> None:
        sound = stream.record(FRAME_SAMPLES)[:, 0]
        self._ask_latency(stream)
        if self._num_frames < LATENCY_FRAMES[0]:
            self._captured_s = None
            return  # when it was captured is not known yet
        seen_s = time.monotonic() - FRAME_S - self.state.latency_s
        due_s = seen_s if self._captured_s is None else self._captured_s + FRAME_S
        error_s = seen_s - due_s
        if error_s > CLOCK_LEAP_S:
            due_s = seen_s
        else:
            due_s += max((EARLY_STEP if error_s < 0 else LATE_STEP) * error_s, -FRAME_S / 2)
        self._captured_s = due_s
        frame = np.ascontiguousarray(np.clip(sound, -1, 1), np.float32)
        if (clean := self.clean) is not None:
            frame = clean(frame)
        self.level = level_of(frame)
        self._on_frame(frame, round(due_s * 1e6))


def _soundcard() -> Any:
    """The library; it connects to the sound system when it is imported. Where that fails for one
    thread, another that waits for the same import would be given half of the library."""
    try:
        with _IMPORTING:
            import soundcard
    except ModuleNotFoundError as error:
        raise VoiceError(NO_LIBRARY) from error
    except Exception as error:  # AssertionError without a server, OSError without its library
        raise VoiceError(
            NO_SOUND.format(str(error).partition(": ")[0] or "no server answers")
        ) from error
    return soundcard


def _names(list_all: Callable[[], list[Any]], get_default: Callable[[], Any]) -> list[str]:
    try:  # the default may be a monitor, which is not among all
        return list(dict.fromkeys(each.name for each in (get_default(), *list_all())))
    except Exception:  # there is no default where there is no device
        return []


def _found(
    name: str, list_all: Callable[[], list[Any]], get_default: Callable[[], Any], kind: str
) -> tuple[Any, str]:
    """The device of a name, or else the default one with a note that says so."""
    try:
        default = get_default()
    except Exception as error:  # each sound system has its own words for it
        raise VoiceError(f"no {kind} on this machine") from error
    for device in (default, *list_all()):
        if name in ("", device.name):
            return device, ""
    return default, f"no {kind} {name!r}; {default.name!r} is used"
