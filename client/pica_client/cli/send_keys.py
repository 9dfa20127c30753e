"""Keys for who sends from a terminal: mute, freeze, calibrate, leave; as in the viewer.

Where the terminal cannot be read key by key (a pipe, a service, Windows), there are none.
"""

import asyncio
import os
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import Final

from pica_client.publish.face_desk import FaceDesk
from pica_client.publish.face_track import FaceMode
from pica_client.voice.publisher import VoicePublisher

try:
    import termios
    import tty
except ImportError:  # Windows
    termios = tty = None  # type: ignore[assignment]

HELP: Final = "keys: M mutes the face, F freezes it, T mutes the voice, K calibrates, Q leaves"
_LOOK_S: Final = 0.1
"""How often news of the desk are looked for."""


class SendKeys:
    """What each key does."""

    def __init__(
        self,
        desk: FaceDesk,
        voice: VoicePublisher | None,
        say: Callable[[str], None],
        leave: Callable[[], None],
    ) -> None:
        self._desk = desk
        self._voice = voice
        self._say = say
        self._leave = leave

    def press(self, key: str, now: float) -> None:
        """Do what a key means at `now`, seconds; others mean nothing."""
        publisher, voice = self._desk.publisher, self._voice
        match key.lower():
            case "m" | "f" as letter:
                wanted: FaceMode = "muted" if letter == "m" else "frozen"
                publisher.mode = "sent" if publisher.mode == wanted else wanted
                self._say(f"your face is {publisher.mode}")
            case "t" if voice is not None:
                voice.is_muted = not voice.is_muted
                self._say("your voice is muted" if voice.is_muted else "your voice is sent")
            case "t":
                self._say("no voice is sent: see --voice")
            case "k":
                self._desk.calibrate(now)
            case "q":
                self._leave()
            case "?" | "h":
                self._say(HELP)

    def handle_timer(self, now: float) -> None:
        """Say what became of a calibration; at any time, as ten times a second."""
        for notice in self._desk.take_notices(now):
            self._say(notice)


@asynccontextmanager
async def read_keys(keys: SendKeys, terminal: int) -> AsyncIterator[bool]:
    """Obey keys while the block runs.

    Yields:
        Whether there are keys; the terminal is as before afterwards. Ctrl-C stays what it is.
    """
    loop = asyncio.get_running_loop()
    if termios is None or not os.isatty(terminal) or _is_in_background(terminal):
        yield False
        return

    def read() -> None:
        pressed = b""
        with suppress(OSError):
            pressed = os.read(terminal, 64)
        if not pressed:  # the terminal is gone; that alone ends no call
            loop.remove_reader(terminal)
        for key in pressed.decode("ascii", "ignore"):
            keys.press(key, loop.time())

    async def look() -> None:
        while True:
            keys.handle_timer(loop.time())
            await asyncio.sleep(_LOOK_S)

    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)
    loop.add_reader(terminal, read)
    looking = asyncio.create_task(look(), name="keys")
    try:
        yield True
    finally:
        looking.cancel()
        loop.remove_reader(terminal)
        with suppress(termios.error):
            termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def _is_in_background(terminal: int) -> bool:
    """Whether the system would stop us if we changed the terminal: a shell's job behind an &."""
    with suppress(OSError):  # it does not steer our process group
        return os.tcgetpgrp(terminal) != os.getpgrp()
    return False
