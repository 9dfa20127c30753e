"""`pica view` for a person: their preferences, the form that asks where to, and their own face.

`view.View` is one stay in one room; this is what lies around it.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from pica_client.avatars.library import AvatarLibrary
from pica_client.errors import AvatarLookupError, OptionError, RelayError, SourceError
from pica_client.output import say
from pica_client.publish.own_face import DEFAULT_SOURCE, FaceChoice, OutgoingFace, open_own_face
from pica_client.transport.config import LinkConfig
from pica_client.ui.join_form import JoinForm, follow_invite
from pica_client.ui.options import ViewOptions, check_voice, connect_timeout_s, parse_size
from pica_client.ui.state import PreferencesFile, ViewState
from pica_client.ui.view import NOTHING_SHOWN, View
from pica_client.voice.opus import available
from pica_client.voice.sound.process import SoundProcess
from pica_core.errors import AvatarFileError

DEFAULT_URL = "ws://127.0.0.1:8765"
DEFAULT_ROOM = "lobby"
DEFAULT_NAME = "viewer"
WATCH = "none"
"""What ``--send`` is given by a user who only watches."""
JOINING_ERRORS = (RelayError, SourceError, AvatarLookupError, AvatarFileError, OptionError)
"""What can be mended at the form."""
OF_THE_FORM = ("ca_file", "secret_file", "avatar", "source", "voice")
"""Without the form these come from the command line alone, and are not kept."""

Stopping = Callable[[Callable[[], None]], AbstractContextManager[None]]
"""Makes a signal call what it is given, for the length of a block."""


def first_state(options: ViewOptions, kept: PreferencesFile | None, *, asks: bool) -> ViewState:
    """What the command line gives, else what was kept, else defaults.

    Args:
        kept: The preferences; None takes none, and keeps none.
        asks: Whether the form asks, with all this in its fields.

    Raises:
        OptionError: An option cannot be right.
    """
    state = ViewState(has_seen_hint=True) if kept is None else kept.load()
    if not asks:
        state.url = state.room = state.name = state.avatar = state.ca_file = state.secret_file = ""
        state.invited_url = ""
        state.source = state.voice = None
    given = {"url": options.url, "room": options.room, "name": options.name}
    given |= {"avatar": options.own_avatar, "layout": options.layout}
    given |= {name: str(getattr(options, name) or "") for name in ("ca_file", "secret_file")}
    for name, value in given.items():
        if value:
            setattr(state, name, value)
    if options.link:
        try:
            follow_invite(state, options.link)
        except ValueError as error:
            raise OptionError(f"link: {error}") from error
    state.url, state.room = state.url or DEFAULT_URL, state.room or DEFAULT_ROOM
    state.name = state.name or ("" if asks else DEFAULT_NAME)
    _choose_face(options, state, asks=asks)
    _choose_sound(options, state, asks=asks)
    state.show_statistics |= options.statistics
    if options.viewer.keep_in is not None:
        state.keep_in = str(options.viewer.keep_in.absolute())
    if options.viewer.size is not None:
        state.window_size = parse_size(options.viewer.size)
    return state


def _choose_face(options: ViewOptions, state: ViewState, *, asks: bool) -> None:
    """A person at a form is to be seen, unless they choose otherwise."""
    if options.send is not None:
        state.source = "" if options.send == WATCH else options.send
    elif state.source is None:
        state.source = DEFAULT_SOURCE if asks else ""
    if options.own_avatar is not None and not state.source:
        raise OptionError(
            f"own-avatar is the look of one's own face; to send one, add --send {DEFAULT_SOURCE}"
        )


def _choose_sound(options: ViewOptions, state: ViewState, *, asks: bool) -> None:
    voice, sound = options.voice, state.sound
    if options.speaker not in ("", "off"):
        sound = replace(sound, speaker=options.speaker)
    if voice is not None and voice.startswith("mic:"):
        voice, sound = "mic", replace(sound, microphone=voice.removeprefix("mic:"))
    if options.clean is not None:
        sound = replace(sound, cleans=options.clean)
    state.sound = sound
    if voice is None and asks and available() is None:
        voice = state.voice or ("mic" if find_spec("soundcard") else None)
    state.voice = voice or "none"
    if not asks:  # at the form a voice can be chosen
        check_voice(state.source or "", state.voice)


def link_of(options: ViewOptions, state: ViewState) -> LinkConfig:
    """The connection that is asked for.

    A token file is for the relay of ``--url``, or for one that the user has typed: an invite link
    must not take its token to another relay.

    Raises:
        OptionError: A part of it cannot be right; names it.
    """
    url, token = state.url.strip(), state.token.strip()
    needs_ca = options.ca_file is not None or "wss://" in url
    return LinkConfig(
        url=url,
        room=state.room.strip(),
        name=state.name.strip(),
        connect_timeout_s=connect_timeout_s(wait=options.wait, seconds=options.seconds),
        secret_file=_path(state.secret_file),
        token=token,
        token_file=None if token or withholds_token(options, state) else options.token_file,
        ca_file=_path(state.ca_file) if needs_ca else None,
        redirect_hosts=options.redirect_hosts,
    )


def withholds_token(options: ViewOptions, state: ViewState) -> bool:
    """Return True if the token file is for another relay than the one that an invite link named."""
    wanted = _origin(state.url)
    is_invited = wanted == _origin(state.invited_url)
    return is_invited and wanted != _origin(options.url or DEFAULT_URL)


def face_of(options: ViewOptions, state: ViewState) -> FaceChoice:
    """The face that is asked for."""
    avatar = state.avatar.strip() or None
    return FaceChoice(source=state.source or "", avatar=avatar, give=options.give_avatar)


def look(
    options: ViewOptions,
    state: ViewState,
    library: AvatarLibrary,
    stopping: Stopping,
    *,
    kept: PreferencesFile | None = None,
) -> dict[str, Any]:
    """Stay in the room that the state names.

    Args:
        stopping: How signals end it.
        kept: Where preferences go afterwards.

    Raises:
        See `View.run` and `open_own_face`.
    """
    _say_token_withheld(options, state)
    while True:
        link = link_of(options, state)
        own = open_own_face(face_of(options, state), link, library, say)
        looking = View(options, state, link, library, face=own)
        with stopping(looking.stop):
            result = looking.run()
        if kept is not None:
            kept.save(state, leaving=OF_THE_FORM)
        if not state.wants_rejoin:
            return result


def ask_and_look(
    options: ViewOptions,
    state: ViewState,
    library: AvatarLibrary,
    stopping: Stopping,
    *,
    form: JoinForm | None = None,
    kept: PreferencesFile | None = None,
) -> dict[str, Any]:
    """Ask where to go, stay there, and ask again, with the reason, when the relay refuses.

    Returns:
        As `look`; ``{"frames_rendered": 0, "render_fps": 0.0}`` when the user left at the form.
    """
    # Only here: a call without the form needs no window before it.
    from pica_client.ui.lobby import Lobby
    from pica_client.ui.window import Window

    form = form or JoinForm(state, partial(link_of, options))
    with ExitStack() as stack:
        window = stack.enter_context(Window(state.window_size))
        sound = None if available() else stack.enter_context(closing(SoundProcess()))
        lobby = stack.enter_context(Lobby(window, library, sound))
        pool = stack.enter_context(ThreadPoolExecutor(1, thread_name_prefix="own-face"))
        while lobby.ask(form):
            link = link_of(options, state)
            _say_token_withheld(options, state)
            try:
                opening = pool.submit(open_own_face, face_of(options, state), link, library, say)
                if not lobby.wait("Getting your avatar …", opening.done):
                    form.ask_again()
                    continue
                looking = View(
                    options,
                    state,
                    link,
                    library,
                    face=opening.result(),
                    window=window,
                    sound=sound,
                    waiting=lambda: lobby.show_waiting("Connecting …"),
                )
                with stopping(looking.stop):
                    result = looking.run()
            except JOINING_ERRORS as error:
                form.refuse(error)
                continue
            finally:
                opening.add_done_callback(_let_go)
            if looking.was_cancelled:
                form.ask_again()
                continue
            if kept is not None:
                kept.save(state)
            if not state.wants_rejoin:
                return result
    return dict(NOTHING_SHOWN)


def _say_token_withheld(options: ViewOptions, state: ViewState) -> None:
    if options.token_file is not None and not state.token and withholds_token(options, state):
        url = state.url.strip()
        say(f"token-file is not sent where the invite link leads; --url {url!r} would send it")


def _origin(url: str) -> tuple[str, str | None, int | None]:
    """The scheme, host and port of an address, which credentials belong to; nothing of one that
    cannot be read, which `LinkConfig` refuses."""
    ports = {"ws": 80, "wss": 443}
    try:
        parts = urlsplit(url.strip())
        return parts.scheme, parts.hostname, parts.port or ports.get(parts.scheme)
    except ValueError:
        return "", None, None


def _let_go(opening: Future[OutgoingFace | None]) -> None:
    """Free a tracker's port once the face is there and not wanted any more."""
    if opening.exception() is None and (face := opening.result()) is not None:
        face.publisher.close()


def _path(text: str) -> Path | None:
    return Path(text.strip()).expanduser() if text.strip() else None
