"""All that makes and takes sound: mixer, loudspeaker, microphone, echo canceller.

It runs in a process of its own (`python -m pica_client.voice.sound.worker`, begun by
`process.SoundProcess`): there a picture that is being drawn holds up no sound, and a sound library
that crashes takes nothing else with it. Both ends send each other pickles, through the standard
input and output:

    in     (method of `SoundWorker`, arguments)
    out    SoundState, 50 times a second
           ("captured", samples, captured_us)       while the microphone is open
           ("mixed", samples, leaves_s)             while that is wanted
"""

import os
import pickle
import queue
import signal
import sys
import threading
from contextlib import suppress
from dataclasses import replace
from typing import Any, BinaryIO, Self

import numpy as np

from pica_client.errors import VoiceError
from pica_client.voice.mixer import VoiceMixer
from pica_client.voice.opus import FRAME_SAMPLES, SAMPLE_RATE_HZ
from pica_client.voice.sound.devices import RETRY_S, Loudspeaker, Microphone, microphones, speakers
from pica_client.voice.sound.settings import SoundSettings, SoundState
from pica_core.types import Array, FloatArray

MAX_WAITING = 500
"""Messages that wait for the other end, which reads as fast as it can; more are dropped."""
PART = FRAME_SAMPLES // 2
"""Samples that the echo canceller takes at once: 10 ms."""
MAX_DELAY_MS = 500
"""Longest delay that it is told."""


class Outbox:
    """Writes messages on a thread of its own, so that callers do not wait for the other end."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._waiting: queue.Queue[Any] = queue.Queue(MAX_WAITING)
        self._thread = threading.Thread(target=self._write, name="sound-outbox", daemon=True)
        self._thread.start()

    def put(self, message: Any) -> None:
        """Send a message; drops it when too many wait."""
        with suppress(queue.Full):
            self._waiting.put_nowait(message)

    def close(self) -> None:
        """Send what waits, and close the file; an end that does not read is not waited for."""
        self.put(None)
        self._thread.join(timeout=1.0)

    def _write(self) -> None:
        with suppress(OSError, ValueError), self._file:  # the other end is gone
            while (message := self._waiting.get()) is not None:
                self._file.write(pickle.dumps(message))
                self._file.flush()


class EchoCanceller:
    """Takes out of a microphone what the loudspeaker put into it, and noise, and evens out its
    loudness: WebRTC's own, in the `livekit` wheel. `play` and `clean` are on threads of their own.

    Raises:
        VoiceError: The extra is missing; names the line that installs it.
    """

    def __init__(self) -> None:
        try:
            from livekit import rtc
        except ImportError as error:
            raise VoiceError(
                "echo cancellation is missing: pip install 'pica-telepresence[echo]'"
            ) from error
        self._frame: Any = rtc.AudioFrame
        self._apm: Any = rtc.AudioProcessingModule(
            echo_cancellation=True,
            noise_suppression=True,
            high_pass_filter=True,
            auto_gain_control=True,
        )
        self._lock = threading.Lock()

    def play(self, sound: Array, delay_s: float) -> None:
        """Take what is played now, float32 ``[FRAME_SAMPLES, 2]``, and how long sound takes from
        here to the loudspeaker and from the air to `clean`."""
        with self._lock:
            self._apm.set_stream_delay_ms(min(round(delay_s * 1e3), MAX_DELAY_MS))
            for part in sound.mean(axis=1).reshape(-1, PART):
                self._apm.process_reverse_stream(self._part(part))

    def clean(self, sound: FloatArray) -> FloatArray:
        """What is left of a frame of the microphone without echo and noise."""
        parts = [self._part(part) for part in sound.reshape(-1, PART)]
        with self._lock:
            for part in parts:
                self._apm.process_stream(part)
        cleaned = np.concatenate([np.frombuffer(part.data, np.int16) for part in parts])
        return (cleaned / 32768).astype(np.float32)

    def _part(self, sound: Array) -> Any:
        data = np.round(np.clip(sound, -1, 1) * 32767).astype(np.int16).tobytes()
        return self._frame(data, SAMPLE_RATE_HZ, 1, PART)


class SoundWorker:
    """The sound of one call; its methods are for one thread. What is said of voices goes straight
    to the mixer: `receive`, `seat`, `set_volumes`."""

    def __init__(self, outbox: Outbox) -> None:
        self._outbox = outbox
        self._mixer = mixer = VoiceMixer()
        self.receive, self.seat, self.set_volumes = mixer.receive, mixer.seat, mixer.set_volumes
        self._loudspeaker = Loudspeaker(self._mixer)
        self._loudspeaker.on_played = self._played
        self._microphone: Microphone | None = None
        self._canceller: EchoCanceller | None = None
        self._no_cleaning = ""
        self._names: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
        self._stopping = threading.Event()

    def __enter__(self) -> Self:
        threading.Thread(target=self._list_devices, name="device-list", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        for device in (self._loudspeaker, self._microphone):
            if device is not None:
                device.stop()

    def follow(self, settings: SoundSettings, has_microphone: bool) -> None:
        """Do what the user has set; the microphone is opened only if one is wanted."""
        self._mixer.volume = settings.volume
        self._loudspeaker.choose(settings.speaker)
        self._loudspeaker.start()
        if has_microphone and self._microphone is None:
            self._microphone = Microphone(self._captured, settings.microphone)
            self._microphone.start()
        elif not has_microphone and self._microphone is not None:
            self._microphone.stop()
            self._microphone = None
        if self._microphone is not None:
            self._microphone.choose(settings.microphone)
            if settings.cleans and self._canceller is None and not self._no_cleaning:
                try:
                    self._canceller = EchoCanceller()
                except VoiceError as error:
                    self._no_cleaning = str(error)
            canceller = self._canceller if settings.cleans else None
            self._microphone.clean = None if canceller is None else canceller.clean

    def hand_on(self, is_wanted: bool) -> None:
        """Send what is mixed, as for a recording, or no longer."""
        put = self._outbox.put
        self._mixer.on_mixed = (lambda *mixed: put(("mixed", *mixed))) if is_wanted else None

    def _captured(self, sound: FloatArray, captured_us: int) -> None:
        self._outbox.put(("captured", sound, captured_us))

    def _played(self, sound: FloatArray) -> None:
        microphone, canceller = self._microphone, self._canceller
        speaker, mixer = self._loudspeaker.state, self._mixer
        if canceller is not None and microphone is not None:
            canceller.play(sound, speaker.latency_s + microphone.state.latency_s)
        state = SoundState(
            speaker=speaker,
            speaker_level=mixer.level,
            speakers=self._names[0],
            microphones=self._names[1],
            cleaning=self._no_cleaning,
            voices=mixer.voices(),
        )
        if microphone is not None:
            state = replace(state, microphone=microphone.state, microphone_level=microphone.level)
        self._outbox.put(state)

    def _list_devices(self) -> None:
        while not self._stopping.is_set():
            with suppress(VoiceError):
                self._names = tuple(speakers()), tuple(microphones())
            self._loudspeaker.offer(self._names[0])
            if (microphone := self._microphone) is not None:
                microphone.offer(self._names[1])
            self._stopping.wait(RETRY_S)


def main() -> None:
    """Do what the parent says until it has nothing more to say, or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends us
    file = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no message
    outbox = Outbox(file)
    with SoundWorker(outbox) as worker, suppress(EOFError, OSError):
        while True:
            name, arguments = pickle.load(sys.stdin.buffer)
            getattr(worker, name)(*arguments)
    outbox.close()


if __name__ == "__main__":
    main()
