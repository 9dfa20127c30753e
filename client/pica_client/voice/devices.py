"""Microphone and loudspeaker, each on a thread of its own; a call goes on without them.

SoundCard rather than sounddevice: it speaks to PulseAudio and PipeWire, Core Audio and Windows
itself, so every device has its own name, a new one is found without a restart, and what the
hardware is not (48 kHz, one or two channels) the system converts. PortAudio lists devices once, and
as Debian builds it knows one "pulse" for all.

A device that is missing, busy or unplugged is said in `DeviceState.note` and tried again every
`RETRY_S`; meanwhile voices are pulled all the same, so that their faces go on.
"""

import asyncio
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np

from pica_client.errors import VoiceError
from pica_client.voice.mixer import VoiceMixer
from pica_client.voice.packet import FRAME_S, FRAME_SAMPLES, SAMPLE_RATE_HZ
from pica_core.types import FloatArray

RETRY_S = 2.0
"""Between two tries of a device that is not there."""
BUFFER_FRAMES = 2
"""Frames that the system keeps for a loudspeaker (chosen: with one, a busy machine crackles)."""
LOST_FRAMES, LOST_RATIO = 10, 0.2
"""A loudspeaker that takes so many frames in less than this share of their time is not there."""
LATENCY_FRAMES = (10, 50)
"""After so many frames a device is asked for its latency, and not again: PulseAudio's library ends
the whole process when it is asked of a device that has just been unplugged."""
MAX_CAPTURED = 10
"""Frames of a microphone that wait; the oldest is dropped beyond: 200 ms."""
EARLY_STEP, LATE_STEP = 0.1, 0.01
"""Shares of an error of the capture clock that are mended with each frame: a frame that comes early
tells the truth, one that comes late mostly that the machine was busy."""
CLOCK_LEAP_S = 1.0
"""An error of the capture clock that is mended at once: the machine slept."""
NO_DEVICE = "none"
"""The loudspeaker that makes no sound: voices are played all the same, and can be recorded."""
NO_SOUND = "no sound system: {}; install the extra voice, and on Linux PulseAudio or PipeWire"


@dataclass(frozen=True, slots=True)
class DeviceState:
    """How a device stands, for people."""

    name: str = ""
    """What it is called; empty while none is open."""
    note: str = ""
    """What is wrong; empty: nothing."""
    latency_s: float = 0.0
    """What the device and its system say of themselves; 0 where they do not."""


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
        """Begin to open the device."""
        self._thread.start()

    def stop(self) -> None:
        """End, and wait for it; twice is once."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    def choose(self, name: str) -> None:
        """Go over to another device, from the next frame; empty: the system's default."""
        self._wanted = name
        self._is_changed.set()

    def _run(self) -> None:
        while not self._stopping.is_set():
            self._is_changed.clear()
            self._num_frames = 0
            try:
                stream = self._open(self._wanted)
                stream.__enter__()
                while not self._stopping.is_set() and not self._is_changed.is_set():
                    self._work(stream)
                # What is lost is not closed: that, too, would end the process.
                stream.__exit__(None, None, None)
            except Exception as error:  # whatever a sound system throws, the call goes on
                words = str(error) if isinstance(error, VoiceError) else f"sound lost: {error}"
                self.state = DeviceState(note=words)
                self._wait(time.monotonic() + RETRY_S)

    def _wait(self, until_s: float) -> None:
        self._stopping.wait(until_s - time.monotonic())

    def _ask_latency(self, stream: Any) -> None:
        self._num_frames += 1
        if self._num_frames in LATENCY_FRAMES:  # and it took its time for the last frame
            latency_s = float(getattr(stream, "latency", 0.0))
            if 0 < latency_s < 2:
                self.state = DeviceState(self.state.name, latency_s=latency_s)

    @abstractmethod
    def _open(self, name: str) -> AbstractContextManager[Any]: ...

    @abstractmethod
    def _work(self, stream: Any) -> None: ...


class Loudspeaker(_Device):
    """Plays what a mixer mixes."""

    def __init__(self, mixer: VoiceMixer, name: str = "") -> None:
        super().__init__(name)
        self._mixer = mixer
        self._played_s: deque[float] = deque(maxlen=LOST_FRAMES)
        self._test: list[FloatArray] = []

    def play_test(self, sound: FloatArray) -> None:
        """Play a sound over the call, to hear that it can be heard. float32, mono."""
        whole = sound[: len(sound) // FRAME_SAMPLES * FRAME_SAMPLES]
        self._test = list(whole.reshape(-1, FRAME_SAMPLES))

    def _open(self, name: str) -> AbstractContextManager[Any]:
        self._played_s.clear()
        if name == NO_DEVICE:
            self.state = DeviceState(NO_DEVICE)
            return _NoSpeaker()
        card = _soundcard()
        device = _found(name, card.all_speakers, card.default_speaker, "loudspeaker")
        channels = min(device.channels, 2)
        self.state = DeviceState(device.name, latency_s=BUFFER_FRAMES * FRAME_S)
        player: AbstractContextManager[Any] = device.player(
            SAMPLE_RATE_HZ, channels=channels, blocksize=BUFFER_FRAMES * FRAME_SAMPLES
        )
        return player

    def _work(self, stream: Any) -> None:
        times = self._played_s
        if len(times) > 1 and times[-1] - times[-2] > LOST_RATIO * FRAME_S:
            self._ask_latency(stream)
        sound = self._mixer.mix(time.monotonic(), self.state.latency_s)
        if self._test:
            sound = sound + self._test.pop(0)[:, None]
        stream.play(sound if stream.channels == 2 else sound.mean(axis=1, keepdims=True))
        times.append(time.monotonic())
        if len(times) == LOST_FRAMES and times[-1] - times[0] < LOST_RATIO * LOST_FRAMES * FRAME_S:
            raise VoiceError(f"loudspeaker {self.state.name!r} is gone; another can be chosen")

    def _wait(self, until_s: float) -> None:
        while time.monotonic() < until_s and not self._is_changed.is_set():
            self._mixer.mix(time.monotonic())
            if self._stopping.wait(FRAME_S):
                return


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
    """Captures a voice; a source of `voice.publisher.VoicePublisher`.

    Attributes:
        offset_us: Is added to each capture time: how much later a tracker sees than this hears.
    """

    def __init__(
        self,
        name: str = "",
        *,
        clean: Callable[[FloatArray], FloatArray] | None = None,
        offset_us: int = 0,
    ) -> None:
        """Prepare.

        Args:
            name: Of the device; empty for the system's default.
            clean: Takes each frame through echo cancellation and the like.
            offset_us: See the attribute.
        """
        super().__init__(name)
        self.offset_us = offset_us
        self._clean = clean
        self._loop: asyncio.AbstractEventLoop | None = None
        self._frames: asyncio.Queue[tuple[FloatArray, int]] = asyncio.Queue(MAX_CAPTURED)
        self._captured_s: float | None = None

    async def frames(self, stopping: asyncio.Event) -> AsyncIterator[tuple[FloatArray, int]]:
        """20 ms after 20 ms with the time of its first sample; see `VoiceSource`."""
        self._loop = asyncio.get_running_loop()
        self.start()
        end = asyncio.create_task(stopping.wait())
        try:
            while not stopping.is_set():
                following = asyncio.create_task(self._frames.get())
                await asyncio.wait({following, end}, return_when=asyncio.FIRST_COMPLETED)
                if not following.done():
                    following.cancel()
                    return
                yield following.result()
        finally:
            end.cancel()
            await asyncio.to_thread(self.stop)

    def _open(self, name: str) -> AbstractContextManager[Any]:
        card = _soundcard()
        device = _found(name, card.all_microphones, card.default_microphone, "microphone")
        self.state, self._captured_s = DeviceState(device.name), None
        recorder: AbstractContextManager[Any] = device.recorder(
            SAMPLE_RATE_HZ, channels=1, blocksize=FRAME_SAMPLES // 2
        )
        return recorder

    def _work(self, stream: Any) -> None:
        sound = stream.record(FRAME_SAMPLES)[:, 0]
        self._ask_latency(stream)
        seen_s = time.monotonic() - FRAME_S - self.state.latency_s
        due_s = seen_s if self._captured_s is None else self._captured_s + FRAME_S
        error_s = seen_s - due_s
        if error_s > CLOCK_LEAP_S:
            due_s = seen_s
        else:
            due_s += max((EARLY_STEP if error_s < 0 else LATE_STEP) * error_s, -FRAME_S / 2)
        self._captured_s = due_s
        frame = np.ascontiguousarray(np.clip(sound, -1, 1), np.float32)
        if self._clean is not None:
            frame = self._clean(frame)
        assert self._loop is not None
        self._loop.call_soon_threadsafe(self._put, frame, round(due_s * 1e6) + self.offset_us)

    def _put(self, frame: FloatArray, captured_us: int) -> None:
        if self._frames.full():
            self._frames.get_nowait()
        self._frames.put_nowait((frame, captured_us))


def _soundcard() -> Any:
    """The library; it connects to the sound system when it is imported."""
    try:
        import soundcard
    except Exception as error:  # AssertionError without a server, OSError without its library
        raise VoiceError(NO_SOUND.format(str(error) or "no server answers")) from error
    return soundcard


def _names(list_all: Callable[[], list[Any]], get_default: Callable[[], Any]) -> list[str]:
    try:
        names = [device.name for device in list_all()]
        first = get_default().name
    except Exception:  # there is no default where there is no device
        return []
    return sorted(dict.fromkeys(names), key=lambda name: name != first)


def _found(
    name: str, list_all: Callable[[], list[Any]], get_default: Callable[[], Any], kind: str
) -> Any:
    if not name:
        try:
            return get_default()
        except Exception as error:  # each sound system has its own words for it
            raise VoiceError(f"no {kind} on this machine") from error
    devices = list_all()
    for device in devices:
        if device.name == name:
            return device
    known = ", ".join(device.name for device in devices)
    raise VoiceError(f"no {kind} {name!r}; there are {known}")
