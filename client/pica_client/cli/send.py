"""`pica send`: one face from a source into a room; `pica agent`: that of a program."""

import asyncio
import sys
from contextlib import closing
from dataclasses import dataclass, field, replace
from io import FileIO
from typing import Annotated, Any

from cyclopts import Parameter

from pica_client.avatars.library import AvatarLibrary
from pica_client.endpoint import Sender
from pica_client.errors import SourceError
from pica_client.publish import DEFAULT_SOURCE, SenderConfig, open_face
from pica_client.system import on_stop_signal, say
from pica_client.ui.options import JoinOptions, check_voice
from pica_client.voice.opus import SAMPLE_RATE_HZ as RATE_HZ
from pica_client.voice.source import PcmSource, VoicePublisher, VoiceSource, open_voice


@dataclass(frozen=True, kw_only=True, slots=True)
class SendOptions:
    """Options of `pica send`."""

    join: Annotated[JoinOptions, Parameter(name="*")] = field(default_factory=JoinOptions)
    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; by default a shipped one that goes by the name."""
    source: str = DEFAULT_SOURCE
    """Whose motion: livelink[:lan], vmc[:lan], ifacialmocap:PHONE_IP and facemotion3d:PHONE_IP
    are trackers, for your own face; csv:FILE[@SECONDS] plays a recording of Live Link
    Face or pica track, performance:NAME[#SEED][@SECONDS] one that ships: talk, listen or
    range_of_motion."""
    voice: str = "none"
    """Whose voice: a WAV file, played over and over; speech, the sentences that ship; speech#K/N,
    the K-th of N who take turns with them; mic, or mic:NAME, a microphone; none."""
    clean: bool = True
    """Take noise out of the microphone, and even out how loud it is, where the extra echo is
    installed."""
    sender: Annotated[SenderConfig, Parameter(name="*")] = field(default_factory=SenderConfig)


def send(options: SendOptions) -> dict[str, Any]:
    """Send a face to a room, from a recording or a performance.

    Reads expressions, encodes them and streams the latents.

    Runs until Ctrl-C or for --seconds, and comes back by itself when the relay goes away and
    returns.
    """
    check_voice(options.source, options.voice)
    return _send(options, open_voice(options.voice, cleans=options.clean))


@dataclass(frozen=True, kw_only=True, slots=True)
class AgentOptions:
    """Options of `pica agent`."""

    join: Annotated[JoinOptions, Parameter(name="*")] = field(default_factory=JoinOptions)
    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; by default a shipped one that goes by the name."""
    pcm: Annotated[str, Parameter(allow_leading_hyphen=True)] = "-"
    """What it says: a file or pipe of signed 16-bit little-endian samples, one channel; - is the
    standard input. At its end the agent leaves."""
    rate: int = RATE_HZ
    """Samples a second, a multiple of 50 from 8000 to 96,000."""


def agent(options: AgentOptions) -> dict[str, Any]:
    """Give a program a voice and a face.

    The voice moves the mouth; beside it the face looks around and blinks, as long as the program
    runs.
    """
    if options.pcm == "-" and sys.stdin.isatty():
        raise SourceError("pcm is -, and the standard input is a terminal: pipe 16-bit PCM into it")
    try:
        # Unbuffered, for nothing may wait for a reader when the agent is ended.
        file = FileIO(0 if options.pcm == "-" else options.pcm)
    except OSError as error:
        raise SourceError(f"pcm {options.pcm} cannot be read: {error.strerror}") from error
    sent = SendOptions(join=options.join, avatar=options.avatar, source="agent")
    return _send(sent, PcmSource(file, options.rate))


def _send(options: SendOptions, voice: VoiceSource | None) -> dict[str, Any]:
    link = options.join.link(seconds=options.sender.seconds)
    with closing(AvatarLibrary()) as library:
        own = open_face(
            options.source,
            link,
            library,
            say,
            avatar=options.avatar,
            give=options.join.give_avatar,
            config=options.sender,
        )
    if voice is not None:
        is_sealed = link.secret_file is not None
        own = replace(own, voice=VoicePublisher(voice, is_sealed=is_sealed))

    async def run() -> dict[str, Any]:
        sender = Sender(link, own, say=say)
        loop = asyncio.get_running_loop()
        with on_stop_signal(lambda: loop.call_soon_threadsafe(sender.stop)):
            await sender.run()
        return sender.stats()

    if options.join.wait:
        say(f"waiting for room {link.room} at {link.url}")
    result = asyncio.run(run())
    say(f"sent {result['sent']} frames, {result['payload_bps'] or 0} bit/s of payload")
    return result
