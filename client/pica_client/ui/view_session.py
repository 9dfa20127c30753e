"""`pica view` for a person: their preferences, the form that asks where to, and their own face.

`view.View` is one stay in one room; this is what lies around it.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import asdict, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pica_client.avatars.library import AvatarLibrary
from pica_client.errors import AvatarLookupError, OptionError, RelayError, SourceError
from pica_client.output import say
from pica_client.publish.own_face import FaceChoice, OutgoingFace, open_own_face
from pica_client.transport.config import LinkConfig
from pica_client.ui.joining.form import Fields, JoinForm
from pica_client.ui.preferences import Preferences, PreferencesFile, fit_side
from pica_client.ui.view import NOTHING_SHOWN, View, ViewConfig
from pica_client.voice.opus import available
from pica_client.voice.sound.process import SoundProcess
from pica_core.errors import AvatarFileError

DEFAULT_URL = "ws://127.0.0.1:8765"
DEFAULT_ROOM = "lobby"
DEFAULT_NAME = "viewer"
MICROPHONE = "mic"
"""The voice of who joins by the form, until they choose another; see `voice.source.open_voice`."""

JOINING_ERRORS = (RelayError, SourceError, AvatarLookupError, AvatarFileError, OptionError)
"""What can be mended at the form."""
KEPT_FIELDS = ("ca_file", "secret_file", "avatar", "source", "voice")

Stopping = Callable[[Callable[[], None]], AbstractContextManager[None]]
"""Makes a signal call what it is given, for the length of a block."""


def invited(link: str) -> Fields:
    """Where an invite link leads.

    Raises:
        OptionError: It is none.
    """
    try:
        return Fields(url=link, voice="").invited()
    except ValueError as error:
        raise OptionError(f"link: {error}") from error


def first_fields(
    given: Fields, preferences: Preferences, *, source_is_given: bool = False
) -> Fields:
    """What stands in the form at first: what the command line gives, else what was kept.

    Args:
        source_is_given: The command line says what plays the user's face, or that nothing does.
    """
    kept_source = None if source_is_given else preferences.source
    kept = {
        name: getattr(given, name) or getattr(preferences, name)
        for name in ("url", "room", "name", "ca_file", "secret_file", "avatar")
    }
    return replace(
        given,
        **kept | {"url": kept["url"] or DEFAULT_URL, "room": kept["room"] or DEFAULT_ROOM},
        source=given.source if kept_source is None else kept_source,
        voice=given.voice or _usual_voice(preferences.voice),
    )


def link_without_form(given: Fields, base: LinkConfig) -> LinkConfig:
    """The connection, where no form asks.

    Raises:
        OptionError: A part of it cannot be right.
    """
    return replace(
        base,
        url=given.url or DEFAULT_URL,
        room=given.room or DEFAULT_ROOM,
        name=given.name or DEFAULT_NAME,
        token=given.token,
        token_file=None if given.token else base.token_file,
    )


def _usual_voice(kept: str | None) -> str:
    """The voice of the last call, or the microphone, where there can be one."""
    if available() is not None:
        return "none"
    return kept or (MICROPHONE if find_spec("soundcard") else "none")


def keep_folder(given: Path | None, preferences: Preferences) -> Path | None:
    """Where pictures and recordings go; None is the system's folders for them."""
    return given or (Path(preferences.keep_in) if preferences.keep_in else None)


def look(
    config: ViewConfig,
    library: AvatarLibrary,
    face: FaceChoice,
    stopping: Stopping,
    *,
    kept: PreferencesFile | None = None,
) -> dict[str, Any]:
    """Stay in the room of the configuration.

    Args:
        stopping: How signals end it.
        kept: Where preferences go afterwards.

    Raises:
        See `View.run` and `open_own_face`.
    """
    while True:
        own = open_own_face(face, config.link, library, say)
        looking = View(config, library, face=own, choice=face)
        with stopping(looking.stop):
            result = looking.run()
        wanted = looking.wanted
        if kept is not None:
            _keep(kept, config, looking)
        if wanted is None:
            return result
        config = replace(config, link=replace(config.link, name=wanted.name), voice=wanted.voice)
        face = replace(face, source=wanted.source, avatar=wanted.avatar or None)


def ask_and_look(
    config: ViewConfig,
    library: AvatarLibrary,
    face: FaceChoice,
    stopping: Stopping,
    *,
    form: JoinForm,
    kept: PreferencesFile | None = None,
) -> dict[str, Any]:
    """Ask where to go, stay there, and ask again, saying why, when the relay will not have us.

    Returns:
        As `look`; ``{"frames_rendered": 0, "render_fps": 0.0}`` when the user left at the form.
    """
    # Only here: who knows where to go needs no window before the call.
    from pica_client.ui.joining.lobby import Lobby
    from pica_client.ui.window import Window

    with ExitStack() as stack:
        window = stack.enter_context(Window(config.viewer.size))
        sound = None if available() else stack.enter_context(closing(SoundProcess()))
        lobby = stack.enter_context(Lobby(window, library, sound))
        pool = stack.enter_context(ThreadPoolExecutor(1, thread_name_prefix="own-face"))
        while lobby.ask(form):
            typed, chosen = form.fields, form.face(face)
            at_first = replace(config.viewer.at_first, sound=typed.sound)
            viewer = replace(config.viewer, at_first=at_first)
            stay = replace(config, link=form.link(), viewer=viewer, voice=typed.voice)
            try:
                opening = pool.submit(open_own_face, chosen, stay.link, library, say)
                if not lobby.wait("Getting your avatar …", opening.done):
                    form.ask_again()
                    continue
                looking = View(
                    stay,
                    library,
                    face=opening.result(),
                    choice=chosen,
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
            wanted = looking.wanted
            if wanted is not None:
                form.fields = replace(form.fields, **asdict(wanted))
            if kept is not None:
                _keep(kept, stay, looking, form.fields)
            if wanted is None:
                return result
    return dict(NOTHING_SHOWN)


def _let_go(opening: Future[OutgoingFace | None]) -> None:
    """Free a tracker's port once the face is there and not wanted any more."""
    if opening.exception() is None and (face := opening.result()) is not None:
        face.publisher.close()


def _keep(
    kept: PreferencesFile, config: ViewConfig, looking: View, fields: Fields | None = None
) -> None:
    """Remember how the user left it, and what stood in the form but for secrets."""
    state = looking.last_controls
    before = kept.load()
    folder = config.viewer.keep_in
    size = looking.last_window_size or before.window_size
    typed = {} if fields is None else {name: getattr(fields, name) for name in KEPT_FIELDS}
    typed["name"] = config.link.name
    if looking.wanted is not None:
        typed |= asdict(looking.wanted)
    elif looking.last_source is not None:
        typed["source"] = looking.last_source
    try:
        now = replace(
            before,
            **typed,
            layout=state.layout,
            show_statistics=state.show_statistics,
            settings=state.settings,
            sound=state.sound,
            has_seen_hint=before.has_seen_hint or not state.shows_hint,
            window_size=(fit_side(size[0]), fit_side(size[1])),
            url=config.link.url,
            room=config.link.room,
            keep_in="" if folder is None else str(folder.absolute()),
        )
    except ValueError as error:  # a folder of an endless name, say
        say(f"{kept.path}: preferences cannot be kept: {error}")
        return
    kept.save(now)
