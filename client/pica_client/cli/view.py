"""`pica view`: everybody in a room, in a window or a recording."""

from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pica_client.avatars.library import AvatarLibrary
from pica_client.avatars.upload import GiveAvatar
from pica_client.cli.options import check_voice, connect_timeout_s, parse_size
from pica_client.errors import OptionError
from pica_client.output import say
from pica_client.publish.own_face import DEFAULT_SOURCE, FaceChoice
from pica_client.render.seats import Layout
from pica_client.signals import on_stop_signal
from pica_client.transport.config import LinkConfig
from pica_client.ui.display import has_display
from pica_client.voice.sound.settings import SoundSettings

WATCH = "none"
"""What ``--send`` is told by who only watches."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewOptions:
    """Options of `pica view`."""

    link: str = field(default="", kw_only=False)
    """An invite link, pica://HOST/ROOM, as `pica token --link` prints it: it fills in the form, or
    says where to go where there is none."""
    url: str | None = None
    """Address of the relay, ws:// or wss://. Without one, and with a display, a form asks; off
    the screen it is ws://127.0.0.1:8765."""
    redirect_hosts: tuple[str, ...] = ()
    """Other hosts that the relay may redirect to, with the token; over wss://, names of its domain
    need not be listed."""
    room: str | None = None
    """Room to look into; lobby by default."""
    name: str | None = None
    """Our own name."""
    send: str | None = None
    """Send one's own face as well: a source as in pica send; none only watches, the default with
    --url. Who joins by the form is seen, by performance:talk if nothing else is named here. M mutes
    the face, F freezes it."""
    own_avatar: str | None = None
    """Avatar of one's own face: a shipped one by its name, or a .pica file; by default a shipped
    one that goes by the name."""
    give_avatar: GiveAvatar = "auto"
    """Give that avatar's file to the relay, for those who do not have it; as in pica send."""
    layout: Layout | None = None
    """How people sit: line, arc, table or grid; L goes through them. By default as it was left."""
    size: str | None = None
    """Columns x rows of the window or picture; by default as the window was left, or 960x540."""
    voice: str | None = None
    """Whose voice is sent: mic, the system's microphone; mic:NAME; or what pica send takes;
    none by default, but mic where a form asks, which can be changed there."""
    speaker: str = ""
    """Loudspeaker by its name; none plays without a sound, off hears nobody; by default the
    system's."""
    clean: bool | None = None
    """Take echo and noise out of the microphone, and even out how loud it is, where the extra echo
    is installed; by default as it was left, which is yes at first."""
    headless: bool = False
    """Draw without a window."""
    record: Path | None = None
    """Record into this MP4 file, which must not be there yet."""
    png: Path | None = None
    """Write the last image into this PNG file."""
    avatar: str | None = None
    """Further avatar files, separated by commas, for peers whose avatar neither ships nor is at the
    relay."""
    seconds: float = 0.0
    """How long to look; 0 is until the window is closed, or Ctrl-C."""
    wait: bool = False
    """Wait for a relay that is not there yet, for --seconds if given, instead of giving up after 3
    seconds."""
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
    frame_log: Path | None = None
    """Write the times of every frame into this file at the end. Those of capture are on the clocks
    of the senders: less ours, they are latencies on this machine only."""
    token_file: Path | None = None
    """File with the join token that the relay wants, see pica token."""
    ca_file: Path | None = None
    """Trust the certificates of this PEM file instead of the system's, at a wss:// address."""
    secret_file: Path | None = None
    """File with the room secret of those who encrypt: shows them, and nobody else."""
    fetch: bool = True
    """Get avatars that are not on this machine from the relay, and keep them."""


def view(options: ViewOptions) -> dict[str, Any]:
    """Show everybody in a room, in a window or in a recording.

    With --headless there is no window. Comes back by itself when the relay goes away and returns.
    """
    if options.record is not None and options.record.is_file():
        raise OptionError(f"{options.record}: is there already; move it away or name another file")
    from pica_client.render.views import EYE_DISTANCE_M
    from pica_client.ui.controls import ControlState
    from pica_client.ui.joining.form import Fields, JoinForm
    from pica_client.ui.preferences import Preferences, PreferencesFile
    from pica_client.ui.view import ViewConfig
    from pica_client.ui.view_session import (
        ask_and_look,
        first_fields,
        invited,
        keep_folder,
        link_without_form,
        look,
    )
    from pica_client.ui.viewer_options import ViewerOptions

    kept = PreferencesFile() if options.preferences and not options.headless else None
    preferences = Preferences() if kept is None else kept.load()
    going = invited(options.link) if options.link else Fields()
    asks = not options.headless and bool(options.link or not options.url) and has_display()
    face = _face(options, asks=asks)
    voice, sound = _sound(options, preferences.sound)
    if not asks:  # at the form a voice can be chosen
        check_voice(face.source, voice)
    going = replace(
        going,
        url=going.url or options.url or "",
        room=going.room or options.room or "",
        name=options.name or "",
        ca_file=str(options.ca_file or ""),
        secret_file=str(options.secret_file or ""),
        avatar=options.own_avatar or "",
        source=face.source,
        voice=voice or "",
        sound=sound,
    )
    base = LinkConfig(
        connect_timeout_s=connect_timeout_s(wait=options.wait, seconds=options.seconds),
        secret_file=options.secret_file,
        token_file=options.token_file,
        redirect_hosts=options.redirect_hosts,
    )
    # Until the form is filled the address is not known to be wss://.
    link = base if asks else replace(link_without_form(going, base), ca_file=options.ca_file)
    config = ViewConfig(
        link=link,
        viewer=ViewerOptions(
            size=preferences.window_size if options.size is None else parse_size(options.size),
            headless=options.headless,
            record=options.record,
            keep_in=keep_folder(options.keep_in, preferences),
            max_fps=options.max_fps,
            frame_budget_ms=options.frame_budget_ms,
            eye_distance_m=EYE_DISTANCE_M if options.stereo else 0.0,
            at_first=ControlState(
                layout=options.layout or preferences.layout,
                show_statistics=options.statistics or preferences.show_statistics,
                settings=preferences.settings,
                sound=sound,
                shows_hint=kept is not None and not preferences.has_seen_hint,
            ),
        ),
        seconds=options.seconds,
        voice=voice or "none",
        hears=options.speaker != "off",
        expect=options.expect,
        png=options.png,
        frame_log=options.frame_log,
        fetch=options.fetch,
    )
    with closing(AvatarLibrary()) as library:
        for name in (options.avatar or "").split(","):
            if name:
                library.load(library.find(name))
        if asks:
            says_source = options.send is not None
            fields = first_fields(going, preferences, source_is_given=says_source)
            form = JoinForm(fields, base=base)
            result = ask_and_look(config, library, face, on_stop_signal, kept=kept, form=form)
        else:
            result = look(config, library, face, on_stop_signal, kept=kept)
    say(f"drew {result['frames_rendered']} images at {result['render_fps']} a second")
    return result


def _sound(options: ViewOptions, kept: SoundSettings) -> tuple[str | None, SoundSettings]:
    """Whose voice to send, None where nothing is said of it, and what devices to use.

    Raises:
        OptionError: A device cannot have such a name.
    """
    voice, sound = options.voice, kept
    if options.speaker not in ("", "off"):
        sound = replace(sound, speaker=options.speaker)
    if voice is not None and voice.startswith("mic:"):
        voice, sound = "mic", replace(sound, microphone=voice.removeprefix("mic:"))
    if options.clean is not None:
        sound = replace(sound, cleans=options.clean)
    return voice, sound


def _face(options: ViewOptions, *, asks: bool) -> FaceChoice:
    """The face of one's own that was asked for; a person at a form is to be seen, unless they say
    otherwise.

    Raises:
        OptionError: It is said how one looks, and not that one is to be seen.
    """
    send = options.send if options.send is not None else (DEFAULT_SOURCE if asks else WATCH)
    source = "" if send == WATCH else send
    if options.own_avatar is not None and not source:
        raise OptionError(
            f"own-avatar says how one's own face looks; to send one, add --send {DEFAULT_SOURCE}"
        )
    return FaceChoice(source=source, avatar=options.own_avatar, give=options.give_avatar)
