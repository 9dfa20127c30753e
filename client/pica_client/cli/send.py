"""`pica send`: one face from a source into a room."""

import asyncio
import os
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import Parameter

from pica_client.avatars.library import AvatarLibrary
from pica_client.avatars.upload import GiveAvatar
from pica_client.endpoint.endpoint import LinkNews, Sender
from pica_client.output import say
from pica_client.publish.face_controls import FaceControls
from pica_client.publish.publisher import DEFAULT_SOURCE, SenderConfig, open_face
from pica_client.system import on_stop_signal
from pica_client.transport.config import LinkConfig, guest_name
from pica_client.ui.options import check_voice, connect_timeout_s
from pica_client.voice.publisher import VoicePublisher
from pica_client.voice.source import open_voice

try:
    import termios
    import tty
except ImportError:  # Windows
    termios = tty = None  # type: ignore[assignment]

HELP: Final = "keys: M mutes the face, T mutes the voice, K calibrates, Q leaves"
NOTICE_PERIOD_S: Final = 0.1
"""How often notices of the controls are looked for."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SendOptions:
    """Options of `pica send`."""

    url: str = "ws://127.0.0.1:8765"
    """Address of the relay, ws:// or wss://."""
    redirect_hosts: tuple[str, ...] = ()
    """Other hosts that the relay may redirect to, with the token; over wss://, names of its domain
    need not be listed."""
    room: str = "lobby"
    """Room to join: letters, digits and _ . -"""
    name: str | None = None
    """Name the others see; Guest and a number by default."""
    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; by default a shipped one that goes by the name."""
    source: str = DEFAULT_SOURCE
    """Whose motion: livelink[:lan], vmc[:lan], ifacialmocap:PHONE_IP and facemotion3d:PHONE_IP
    are trackers, for your own face; csv:FILE[@SECONDS] plays a Live Link Face recording, take:FILE
    one of pica track, performance:NAME[#SEED][@SECONDS] one that ships: talk, listen or
    range_of_motion."""
    voice: str = "none"
    """Whose voice: a WAV file, played over and over; speech, the sentences that ship; speech#K/N,
    the K-th of N who take turns with them; mic, or mic:NAME, a microphone; none."""
    clean: bool = True
    """Take noise out of the microphone, and even out how loud it is, where the extra echo is
    installed."""
    wait: bool = False
    """Wait for a relay that is not there yet, for --seconds if given, instead of giving up after 3
    seconds."""
    sender: Annotated[SenderConfig, Parameter(name="*")] = field(default_factory=SenderConfig)
    token_file: Path | None = None
    """File with the join token that the relay wants, see pica token."""
    ca_file: Path | None = None
    """Trust the certificates of this PEM file instead of the system's, at a wss:// address."""
    secret_file: Path | None = None
    """File with the room secret, from pica secret: encrypts end to end, see docs/privacy.md."""
    give_avatar: GiveAvatar = "auto"
    """Give the avatar's file to the relay, for those who do not have it; auto does, unless it ships
    with this package or there is a secret: the relay's operator can look at the file."""


def send(options: SendOptions) -> dict[str, Any]:
    """Send a face to a room, from a recording or a performance.

    Reads expressions, encodes them and streams the latents.

    Runs until Ctrl-C or for --seconds; in a terminal, M mutes the face, T mutes the voice, K
    calibrates a tracker to a relaxed face, and Q leaves. It comes back by itself when the relay
    goes away and returns.
    """
    check_voice(options.source, options.voice)
    link = LinkConfig(
        url=options.url,
        room=options.room,
        name=options.name or guest_name(),
        connect_timeout_s=connect_timeout_s(wait=options.wait, seconds=options.sender.seconds),
        secret_file=options.secret_file,
        token_file=options.token_file,
        ca_file=options.ca_file,
        redirect_hosts=options.redirect_hosts,
    )
    voice = open_voice(options.voice, cleans=options.clean)
    is_sealed = link.secret_file is not None
    with closing(AvatarLibrary()) as library:
        own = open_face(
            options.source,
            link,
            library,
            say,
            avatar=options.avatar,
            give=options.give_avatar,
            config=options.sender,
        )
    face = own.face
    assert face is not None
    if voice is not None:
        own = replace(own, voice=VoicePublisher(voice, is_sealed=is_sealed))
    where = f"room {link.room} at {link.url}"
    news = LinkNews(f"sending {options.source} as {link.name} to {where}", say)

    async def run() -> dict[str, Any]:
        sender = Sender(link, own, news=news)
        loop = asyncio.get_running_loop()
        controls = FaceControls(face, link.name, options.source)
        keys = SendKeys(controls, own.voice, sender.stop)
        with on_stop_signal(lambda: loop.call_soon_threadsafe(sender.stop)), closing(controls):
            async with keys.read(0):
                await sender.run()
        return sender.stats()

    if options.wait:
        say(f"waiting for {where}")
    result = asyncio.run(run())
    say(f"sent {result['sent']} frames, {result['payload_bps'] or 0} bit/s of payload")
    return result


class SendKeys:
    """The keys of a terminal, as in the viewer: mute, calibrate, leave."""

    def __init__(
        self, controls: FaceControls, voice: VoicePublisher | None, leave: Callable[[], None]
    ) -> None:
        self._controls, self._voice, self._leave = controls, voice, leave

    def press(self, key: str, now: float) -> None:
        """Do what a key means at `now`, seconds; others mean nothing."""
        publisher, voice = self._controls.publisher, self._voice
        match key.lower():
            case "m":
                publisher.mode = "sent" if publisher.mode == "muted" else "muted"
                say(f"your face is {publisher.mode}")
            case "t" if voice is not None:
                voice.is_muted = not voice.is_muted
                say("your voice is muted" if voice.is_muted else "your voice is sent")
            case "t":
                say("no voice is sent: see --voice")
            case "k":
                self._controls.calibrate(now)
            case "q":
                self._leave()
            case "?" | "h":
                say(HELP)

    @asynccontextmanager
    async def read(self, terminal: int) -> AsyncIterator[None]:
        """Take the keys of a terminal while the block runs, and leave it as it was.

        A terminal that cannot be read key by key (a pipe, a service, Windows) gives none, nor does
        one while it belongs to another job of the shell: the system would stop this process.
        """
        loop = asyncio.get_running_loop()
        if termios is None or not os.isatty(terminal):
            yield
            return
        before = termios.tcgetattr(terminal)
        is_reading = False

        def read() -> None:
            if _is_in_background(terminal):
                follow()
                return
            pressed = b""
            with suppress(OSError):
                pressed = os.read(terminal, 64)
            if not pressed:  # the terminal is gone; that alone ends no call
                loop.remove_reader(terminal)
            for key in pressed.decode("ascii", "ignore"):
                self.press(key, loop.time())

        def follow() -> None:
            """Read while this job is in the foreground; the shell has set the terminal itself."""
            nonlocal is_reading
            if is_reading == (not _is_in_background(terminal)):
                return
            is_reading = not is_reading
            if is_reading:
                tty.setcbreak(terminal)
                loop.add_reader(terminal, read)
                say(HELP)
            else:
                loop.remove_reader(terminal)

        async def tell() -> None:
            while True:
                follow()
                for notice in self._controls.take_notices(loop.time()):
                    say(notice)
                await asyncio.sleep(NOTICE_PERIOD_S)

        follow()
        telling = asyncio.create_task(tell(), name="keys")
        try:
            yield
        finally:
            telling.cancel()
            loop.remove_reader(terminal)
            if not _is_in_background(terminal):
                with suppress(termios.error):
                    termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def _is_in_background(terminal: int) -> bool:
    """Return True if the system would stop us for using the terminal: another job has it."""
    with suppress(OSError):  # it does not steer our process group
        return os.tcgetpgrp(terminal) != os.getpgrp()
    return False
