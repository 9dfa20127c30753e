"""The process that sound lives in, as the rest of the call sees it."""

import asyncio
import contextlib
import pickle
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from pica_client.voice.jitter_buffer import HeardVoice
from pica_client.voice.sound.settings import DeviceState, SoundSettings, SoundState
from pica_client.voice.sound.worker import Outbox
from pica_core.types import FloatArray
from pica_protocol.frames import Frame

RESTART_S: Final = 2.0
"""Until sound that ended by itself is begun again."""
MAX_CAPTURED: Final = 10
"""Frames of a microphone that wait; the oldest is dropped beyond: 200 ms."""
WIDTH_RAD: Final = 0.7
"""How far to a side the outermost is heard (chosen: five people are told apart)."""


class SoundProcess:
    """Sound in a process of its own, which begins with the first thing that it is told.

    Methods may be called on any thread, and do not wait. It is the ears of a call (`call.Ears`):
    faces are led by what leaves the loudspeaker.

    Attributes:
        state: How sound stood a moment ago.
        on_frame: Is given what the microphone captures while it is used, 20 ms and when the first
            sample was captured, microseconds, on a thread of its own.
        on_trouble: Is given what is wrong with a device whenever that changes, on that thread;
            empty: nothing.
    """

    def __init__(self, settings: SoundSettings | None = None) -> None:
        self.state = SoundState()
        self._on_mixed: Callable[[FloatArray, float], None] | None = None
        self.on_trouble: Callable[[str], None] = lambda trouble: None
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._reading: threading.Thread | None = None
        self._outbox: Outbox | None = None
        self._is_closed = False
        self._begin_s = 0.0
        self._settings, self._users = settings or SoundSettings(), 0
        # What holds until it is set again, for a process that has to begin again.
        self._lasting: dict[str, tuple[Any, ...]] = {"seat": ({},)}
        self.on_frame: Callable[[FloatArray, int], None] = lambda sound, captured_us: None
        self._heard: dict[str, HeardVoice] = defaultdict(HeardVoice)

    def follow(self, settings: SoundSettings) -> None:
        """Do what the user has set."""
        self._settings = settings
        wanted = (settings, self._users > 0)
        if self._lasting.get("follow") != wanted or self._process is None:
            self._last("follow", *wanted)

    def use_microphone(self, is_used: bool) -> None:
        """Open the microphone, or close it after its last user."""
        self._users += 1 if is_used else -1
        self.follow(self._settings)

    def seat(self, peer_ids: Sequence[str]) -> None:
        """Give each peer that is there the place that its voice comes from; forget others."""
        for gone in self._heard.keys() - set(peer_ids):
            self._heard.pop(gone, None)
        places = np.linspace(-1, 1, len(peer_ids)) if len(peer_ids) > 1 else np.zeros(1)
        azimuths_rad = dict(zip(peer_ids, (WIDTH_RAD * places).tolist(), strict=False))
        if self._lasting.get("seat") != (azimuths_rad,):
            self._last("seat", azimuths_rad)

    def set_volumes(self, volumes: Mapping[str, float]) -> None:
        """Make people louder or softer, by peer id: 1 is as sent, 0 mutes them here."""
        self._last("set_volumes", dict(volumes))

    def hand_mix_to(self, on_mixed: Callable[[FloatArray, float], None] | None) -> None:
        """Give something what is mixed from now on and when it leaves the loudspeaker, as
        `VoiceMixer.on_mixed`, on that thread; None: nothing."""
        self._on_mixed = on_mixed
        self._last("hand_on", on_mixed is not None)

    def receive(self, peer_id: str, packet: Frame, arrived_s: float) -> None:
        """Take a packet of a peer's voice."""
        self._tell("receive", peer_id, packet, arrived_s)

    async def frames(self, stopping: asyncio.Event) -> AsyncIterator[tuple[FloatArray, int]]:
        """What the microphone captures; this is a `source.VoiceSource`."""
        loop = asyncio.get_running_loop()
        frames: asyncio.Queue[tuple[FloatArray, int] | None] = asyncio.Queue(MAX_CAPTURED)

        def put(frame: tuple[FloatArray, int] | None) -> None:
            if frames.full():
                frames.get_nowait()
            frames.put_nowait(frame)

        def take(sound: FloatArray, captured_us: int) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has just ended
                loop.call_soon_threadsafe(put, (sound, captured_us))

        end = asyncio.create_task(stopping.wait())
        end.add_done_callback(lambda _: put(None))
        self.on_frame = take
        self.use_microphone(True)
        try:
            while (frame := await frames.get()) is not None and not stopping.is_set():
                yield frame
        finally:
            end.cancel()
            self.use_microphone(False)

    def heard_us(self, peer_id: str, now: float) -> int | None:
        """The moment of a peer's voice that leaves the loudspeaker; see `HeardVoice`."""
        voice = self._heard.get(peer_id)
        return None if voice is None else voice.at(now)

    def close(self) -> None:
        """End it; twice is once."""
        with self._lock:
            self._is_closed = True
            process, self._process = self._process, None
        if process is not None and self._outbox is not None:
            self._outbox.close()
            try:
                process.wait(timeout=2.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if self._reading is not None:
                self._reading.join(timeout=1.0)

    def _last(self, name: str, *arguments: Any) -> None:
        with self._lock:
            self._lasting[name] = arguments
        self._tell(name, *arguments)

    def _tell(self, name: str, *arguments: Any) -> None:
        with self._lock:
            if self._process is None:
                if self._is_closed or time.monotonic() < self._begin_s:
                    return
                self._begin()
            assert self._outbox is not None
            self._outbox.put((name, arguments))

    def _begin(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "pica_client.voice.sound.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self._process.stdin is not None
        self._outbox = Outbox(self._process.stdin)  # type: ignore[arg-type]
        self._lasting.setdefault("follow", (self._settings, False))
        for said in self._lasting.items():
            self._outbox.put(said)
        self._reading = threading.Thread(
            target=self._read, args=(self._process, self._outbox), name="sound", daemon=True
        )
        self._reading.start()

    def _read(self, process: subprocess.Popen[bytes], outbox: Outbox) -> None:
        said = process.stdout
        assert said is not None
        with said, contextlib.suppress(EOFError, OSError, ValueError, pickle.UnpicklingError):
            while True:
                self._take(pickle.load(said))
        if self._is_closed:
            return
        self._take(SoundState(speaker=DeviceState(note="sound ended by itself; it begins again")))
        process.kill()
        process.wait()
        outbox.close()
        with self._lock:
            self._process, self._begin_s = None, time.monotonic() + RESTART_S
        time.sleep(RESTART_S)
        self.follow(self._settings)

    def _take(self, message: Any) -> None:
        match message:
            case SoundState():
                before, self.state = self.state, message
                for peer_id, voice in message.voices.items():
                    if voice.moment is not None:
                        self._heard[peer_id].receive(voice.moment)
                if message.trouble != before.trouble:
                    self.on_trouble(message.trouble)
            case ("captured", sound, captured_us):
                self.on_frame(sound, captured_us)
            case ("mixed", sound, leaves_s):
                if self._on_mixed is not None:
                    self._on_mixed(sound, leaves_s)
