"""``pica send``: one face from a source into a room."""

import asyncio
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import tyro

from pica_client.avatars.library import AvatarLibrary, shipped_avatar_files
from pica_client.avatars.upload import AvatarGiver, Push
from pica_client.cli.options import CONNECT_TIMEOUT_S
from pica_client.local_call.local_call import choose_avatars
from pica_client.output import check_writable, say, writing
from pica_client.publish.sender import Sender, SenderConfig
from pica_client.signals import on_stop_signal
from pica_client.sources import open_source
from pica_client.transport.config import LinkConfig


@dataclass(frozen=True, kw_only=True, slots=True)
class SendOptions:
    """Options of ``pica send``."""

    url: str = "ws://127.0.0.1:8765"
    """Address of the relay, ws:// or wss://."""
    room: str = "lobby"
    """Room to join: letters, digits and _ . -"""
    name: str = "guest"
    """Name the others see."""
    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; the first shipped one by default."""
    source: str = "performance:talk"
    """csv:FILE[@SECONDS] plays a Live Link Face recording, performance:NAME[#SEED][@SECONDS] one
    that ships: talk, listen or range_of_motion."""
    wait: bool = False
    """Wait for a relay that is not there yet instead of giving up after 3 seconds."""
    frame_log: Path | None = None
    """Write capture and encoding time of each frame, in microseconds, into this file at the end."""
    sender: tyro.conf.OmitArgPrefixes[SenderConfig] = field(default_factory=SenderConfig)
    token_file: Path | None = None
    """File with the join token that the relay wants, see pica token."""
    ca_file: Path | None = None
    """Trust the certificates of this PEM file instead of the system's, at a wss:// address."""
    secret_file: Path | None = None
    """File with the room secret, from pica secret: encrypts end to end, see docs/privacy.md."""
    short_tags: bool = False
    """Spend 11 bytes a frame on encryption instead of 19; needs a secret, see docs/privacy.md."""
    give_avatar: Literal["auto", "yes", "no"] = "auto"
    """Give the avatar's file to the relay, for those who do not have it; auto does, unless it ships
    with this package or there is a secret: whoever runs the relay can look at the file."""


def send(options: SendOptions) -> dict[str, Any]:
    """Send one face to a room: read expressions, encode them, stream the latents.

    Runs until Ctrl-C or for --seconds, and comes back by itself when the relay goes away and
    returns.
    """
    if options.frame_log is not None:
        check_writable(options.frame_log)
    link = LinkConfig(
        url=options.url,
        room=options.room,
        name=options.name,
        connect_timeout_s=None if options.wait else CONNECT_TIMEOUT_S,
        secret_file=options.secret_file,
        token_file=options.token_file,
        ca_file=options.ca_file,
        short_tags=options.short_tags,
    )
    source = open_source(options.source)
    library = AvatarLibrary()
    try:
        (chosen, *_) = choose_avatars(options.avatar, library)
        identity = library.find(chosen)
        avatar = library.load(identity)
        path = library.path(identity)
    finally:
        library.close()
    gives = options.give_avatar == "yes" or (
        options.give_avatar == "auto"
        and options.secret_file is None
        and path not in shipped_avatar_files()
    )

    async def run() -> tuple[dict[str, Any], list[tuple[int, int]]]:
        push = Push(path=path, identity=identity, token_file=link.token_file, ca_file=link.ca_file)
        giver = AvatarGiver(push, lambda: sender.relay_url, say)
        on_joined = giver.begin if gives else None
        sender = Sender(options.sender, link, source, avatar, identity, on_joined=on_joined)
        loop = asyncio.get_running_loop()
        try:
            with on_stop_signal(lambda: loop.call_soon_threadsafe(sender.stop)):
                result = await sender.run()
        finally:
            await giver.close()
        return {**result, "avatar_given": giver.outcome}, list(sender.frame_log)

    say(f"sending {options.source} as {options.name} to room {options.room} at {options.url}")
    result, frame_log = asyncio.run(run())
    if options.frame_log is not None:
        with writing(options.frame_log):
            options.frame_log.write_text(json.dumps(frame_log))
    say(f"sent {result['sent']} frames, {result['payload_bps'] or 0} bit/s of payload")
    return result
