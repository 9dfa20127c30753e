"""The commands of the client: thin functions from options to the parts that do the work.

What needs the `view` extra is imported inside its command, so that a sender runs without it.
"""

from __future__ import annotations

import asyncio
import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import tyro

from pica_client.avatars.library import AvatarLibrary, shipped_avatar_files
from pica_client.avatars.upload import AvatarGiver, Push
from pica_client.errors import OptionError
from pica_client.local_call.local_call import LocalCallConfig, choose_avatars
from pica_client.output import check_writable, say, writing
from pica_client.playout.config import PlayoutConfig, playout_with_floor
from pica_client.publish.sender import Sender, SenderConfig
from pica_client.render.seats import Layout
from pica_client.signals import on_stop_signal, terminate_as_interrupt
from pica_client.sources import open_source
from pica_client.transport.config import LinkConfig
from pica_client.ui.display import has_display
from pica_core.codec.latent_stream import DEFAULT_QUALITY

CONNECT_TIMEOUT_S = 3.0
"""How long a command tries to reach a relay before it gives up, unless told to wait."""


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
    fps: float = 30.0
    """Frames a second, 1 to 240."""
    seconds: float = 0.0
    """How long to send; 0 is until Ctrl-C."""
    wait: bool = False
    """Wait for a relay that is not there yet instead of giving up after 3 seconds."""
    frame_log: Path | None = None
    """Write capture and encoding time of each frame, in microseconds, into this file at the end."""
    quality: int = DEFAULT_QUALITY
    """Fineness of the coded stream, 0 to 7; each step up costs a quarter more bits."""
    bitrate: float | None = None
    """Payload bits a second to keep to by changing the quality."""
    plain: bool = False
    """Send 8 bits a value, 65 kbit/s, as avatars without a stream profile are sent."""
    token_file: Path | None = None
    """File with the join token that the relay wants, see pica token."""
    ca_file: Path | None = None
    """With a wss:// address, trust the certificates of this PEM file instead of the system's."""
    secret_file: Path | None = None
    """File with the room secret, from pica secret: encrypts end to end, see docs/privacy.md."""
    short_tags: bool = False
    """With a secret: 11 bytes a frame for encryption instead of 19, see docs/privacy.md."""
    give_avatar: Literal["auto", "yes", "no"] = "auto"
    """Give the avatar's file to the relay, for those who do not have it; auto does, unless it ships
    with this package or there is a secret: whoever runs the relay can look at the file."""


def send(options: SendOptions) -> dict[str, Any]:
    """Send one face to a room: read expressions, encode them, stream the latents.

    Runs until Ctrl-C or for --seconds, and comes back by itself when the relay goes away and
    returns.
    """
    config = SenderConfig(
        fps=options.fps,
        seconds=options.seconds,
        quality=options.quality,
        bitrate_bps=options.bitrate,
        plain=options.plain,
    )
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
        sender = Sender(config, link, source, avatar, identity, on_joined=on_joined)
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


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewOptions:
    """Options of ``pica view``."""

    url: str | None = None
    """Address of the relay, ws:// or wss://. Without one, and with a display, a form asks; off the
    screen it is ws://127.0.0.1:8765."""
    room: str | None = None
    """Room to look into; lobby by default."""
    name: str | None = None
    """Our own name."""
    send: str | None = None
    """Send one's own face as well: a source as in pica send, such as performance:talk. M mutes it,
    F freezes it."""
    own_avatar: str | None = None
    """Avatar of one's own face: a shipped one by its name, or a .pica file."""
    layout: Layout | None = None
    """How people sit: line, arc, table or grid; L goes through them. By default as it was left."""
    size: str | None = None
    """Columns x rows of the window or picture; by default as the window was left, or 960x540."""
    headless: bool = False
    """Draw without a window."""
    record: Path | None = None
    """Record into this MP4 file."""
    png: Path | None = None
    """Write the last image into this PNG file."""
    png_folder: Path | None = None
    """Write an image a second into this folder."""
    avatar: str | None = None
    """Further avatar files, separated by commas, for peers whose avatar neither ships nor is at the
    relay."""
    avatar_folder: Path | None = None
    """A folder with further avatar files."""
    seconds: float = 0.0
    """How long to look; 0 is until the window is closed, or Ctrl-C."""
    wait: bool = False
    """Wait for a relay that is not there yet instead of giving up after 3 seconds."""
    expect: int = 0
    """Begin to draw once so many peers are seen."""
    statistics: bool = False
    """Show the statistics from the start; S toggles them, H shows all keys."""
    keep_in: Path | None = None
    """Folder for the pictures and recordings made by key, instead of the one used last."""
    preferences: bool = True
    """Begin as the last call in a window ended, and remember how this one ends."""
    max_fps: float = 30.0
    """Draw at most so many images a second."""
    frame_budget_ms: float = 0.0
    """What decoding and drawing an image may take before detail is given up; 0 is most of the time
    that --max-fps leaves."""
    stereo: bool = False
    """Draw for two eyes, side by side."""
    playout_floor_ms: float = field(default=PlayoutConfig().floor_s * 1e3)
    """Least playout delay, milliseconds; 33 makes 30 frames a second smooth on a fast display."""
    frame_log: Path | None = None
    """Write the times of every frame into this file at the end."""
    token_file: Path | None = None
    """File with the join token that the relay wants, see pica token."""
    ca_file: Path | None = None
    """With a wss:// address, trust the certificates of this PEM file instead of the system's."""
    secret_file: Path | None = None
    """File with the room secret of those who encrypt: shows them, and nobody else."""
    fetch: bool = True
    """Get avatars that are not on this machine from the relay, and keep them."""
    avatar_cache: Path | None = None
    """Where to keep those, instead of this user's folder for such things."""


def view(options: ViewOptions) -> dict[str, Any]:
    """Show everybody in a room, in a window or, with --headless, into a recording.

    Comes back by itself when the relay goes away and returns.
    """
    from pica_client.call.call import CallConfig
    from pica_client.render.stereo import EYE_DISTANCE_M
    from pica_client.ui.join_form import JoinForm
    from pica_client.ui.preferences import Preferences, PreferencesFile
    from pica_client.ui.view import ViewConfig
    from pica_client.ui.view_session import (
        Destination,
        ask_and_look,
        keep_folder,
        look,
        make_publisher,
    )
    from pica_client.ui.viewer import ViewerOptions

    kept = PreferencesFile() if options.preferences and not options.headless else None
    preferences = Preferences() if kept is None else kept.load()
    going = Destination(url=options.url, room=options.room, name=options.name)
    base = LinkConfig(
        connect_timeout_s=None if options.wait else CONNECT_TIMEOUT_S,
        secret_file=options.secret_file,
        token_file=options.token_file,
    )
    asks = not options.headless and options.url is None and has_display()
    # Until the form is filled the address is not known to be wss://.
    link = base if asks else replace(going.link(base), ca_file=options.ca_file)
    config = ViewConfig(
        link=link,
        call=CallConfig(playout=playout_with_floor(options.playout_floor_ms)),
        viewer=ViewerOptions(
            size=preferences.window_size if options.size is None else _size(options.size),
            headless=options.headless,
            record=options.record,
            keep_in=keep_folder(options.keep_in, preferences),
            max_fps=options.max_fps,
            frame_budget_ms=options.frame_budget_ms,
            layout=options.layout or preferences.layout,
            eye_distance_m=EYE_DISTANCE_M if options.stereo else 0.0,
            show_statistics=options.statistics or preferences.show_statistics,
        ),
        seconds=options.seconds,
        expect=options.expect,
        png=options.png,
        png_folder=options.png_folder,
        frame_log=options.frame_log,
        fetch=options.fetch,
        avatar_cache=options.avatar_cache,
    )
    library = AvatarLibrary(folder=options.avatar_folder)
    try:
        for name in (options.avatar or "").split(","):
            if name:
                library.load(library.find(name))
        publisher = None
        if options.send is not None:
            publisher = make_publisher(options.send, options.own_avatar, library)
        if asks:
            form = JoinForm(going.fields(preferences), base=base, ca_file=options.ca_file)
            result = ask_and_look(config, library, publisher, on_stop_signal, kept=kept, form=form)
        else:
            result = look(config, library, publisher, on_stop_signal, kept=kept)
    finally:
        library.close()
    say(f"drew {result['frames_rendered']} images at {result['render_fps']} a second")
    return result


@dataclass(frozen=True, kw_only=True, slots=True)
class DemoOptions:
    """Options of ``pica demo``."""

    peers: int = 5
    """Number of senders, each a process."""
    seconds: float = 20.0
    """How long the call is drawn."""
    headless: bool = False
    """No window, even where there is a display."""
    size: str = "960x540"
    """Columns x rows of the window or picture."""
    source: str | None = None
    """What all senders play, each starting elsewhere in it; by default shipped performances."""
    avatar: str | None = None
    """Names or .pica files of avatars, separated by commas, dealt in turn."""
    fps: float = 30.0
    """Frames a second of each sender."""
    quality: int = DEFAULT_QUALITY
    """Fineness of the coded streams, 0 to 7."""
    plain: bool = False
    """Send 8 bits a value instead of coded streams."""
    out: Path = Path("demo-out")
    """Folder for call.mp4, frame.png and stats.json."""
    encrypt: bool = False
    """Encrypt end to end, with a secret made for this call."""


def demo(options: DemoOptions) -> dict[str, Any]:
    """Hold a call on this machine: a relay, simulated senders and a viewer.

    Opens a window if there is a display, else draws into a recording. Writes call.mp4, frame.png
    and stats.json.
    """
    from pica_client.cli.demo import DemoConfig, run_demo

    _size(options.size)
    config = DemoConfig(
        stage=LocalCallConfig(
            peers=options.peers,
            source=options.source,
            avatar=options.avatar,
            fps=options.fps,
            quality=options.quality,
            plain=options.plain,
            is_encrypted=options.encrypt,
        ),
        seconds=options.seconds,
        size=options.size,
        is_headless=options.headless or not has_display(),
        out=options.out,
    )
    with terminate_as_interrupt():
        stats = run_demo(config)
    latency = stats["latency_ms"]
    say(
        f"{stats['rendered_peers']} of {stats['peers']} peers drawn at {stats['render_fps']} "
        f"images/s with {stats['gl_renderer']}; source sample to decoded avatar "
        f"p50 {latency['p50']} ms, p99 {latency['p99']} ms; errors: {stats['errors']}"
    )
    say(f"see call.mp4, frame.png and stats.json in {options.out}")
    return stats


@dataclass(frozen=True, kw_only=True, slots=True)
class DoctorOptions:
    """``pica doctor`` has no options."""


def doctor(options: DoctorOptions) -> dict[str, Any]:
    """Say what this machine can do: GL, inference, display, extras, with the fix for each lack."""
    from pica_client.cli.doctor import examine

    findings = examine(has_display=has_display)
    for finding in findings:
        say(finding.line)
    return {"findings": [asdict(finding) for finding in findings]}


@dataclass(frozen=True, kw_only=True, slots=True)
class ThumbnailOptions:
    """Options of ``pica avatar thumbnail``."""

    avatar: tyro.conf.Positional[str]
    """Name of a shipped avatar, or a .pica file."""
    out: Path = Path("avatar.png")
    """PNG file to write."""
    size: str = "256x256"
    """Columns x rows of the picture."""


def avatar_thumbnail(options: ThumbnailOptions) -> dict[str, Any]:
    """Draw an avatar's resting face into a PNG file."""
    from pica_client.render.recorder import save_png
    from pica_client.render.thumbnail import draw_thumbnail

    size = _size(options.size)
    library = AvatarLibrary()
    try:
        avatar = library.load(library.find(options.avatar))
    finally:
        library.close()
    save_png(options.out, draw_thumbnail(avatar, size))
    say(f"wrote {options.out}")
    return {"name": avatar.manifest.name, "out": str(options.out)}


def _size(text: str) -> tuple[int, int]:
    """``960x540`` as columns and rows."""
    columns, _, rows = text.partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise OptionError(f"size is {text!r}; write COLUMNSxROWS, such as 960x540")
    size = int(columns), int(rows)
    if not all(16 <= length <= 8192 for length in size):
        raise OptionError(f"size is {text}; 16 to 8192 columns and rows are allowed")
    return size
