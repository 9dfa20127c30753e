"""`pica view` for a person: their preferences, the form that asks where to, and their own face.

`view.View` is one stay in one room; this is what lies around it.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pica_client.avatars.library import AvatarLibrary
from pica_client.errors import RelayError
from pica_client.local_call.local_call import choose_avatars
from pica_client.output import say
from pica_client.publish.publisher import Publisher, SenderConfig
from pica_client.sources import open_source
from pica_client.transport.config import LinkConfig
from pica_client.ui.join_form import Fields, JoinForm
from pica_client.ui.preferences import Preferences, PreferencesFile, default_keep_folder
from pica_client.ui.view import View, ViewConfig

DEFAULT_URL = "ws://127.0.0.1:8765"
DEFAULT_ROOM = "lobby"
DEFAULT_NAME = "viewer"

Stopping = Callable[[Callable[[], None]], AbstractContextManager[None]]
"""Makes a signal call what it is given, for the length of a block."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Destination:
    """Where to go, as far as the command line says."""

    url: str | None = None
    room: str | None = None
    name: str | None = None

    def fields(self, preferences: Preferences) -> Fields:
        """What stands in the form at first."""
        return Fields(
            url=self.url or preferences.url or DEFAULT_URL,
            room=self.room or preferences.room or DEFAULT_ROOM,
            name=self.name or preferences.name,
        )

    def link(self, base: LinkConfig) -> LinkConfig:
        """The connection without a form.

        Raises:
            OptionError: A part of it cannot be right.
        """
        return replace(
            base,
            url=self.url or DEFAULT_URL,
            room=self.room or DEFAULT_ROOM,
            name=self.name or DEFAULT_NAME,
        )


def make_publisher(source: str, avatar: str | None, library: AvatarLibrary) -> Publisher:
    """What sends one's own face.

    Raises:
        SourceError: The source cannot be opened.
        AvatarLookupError: The avatar is not there.
    """
    opened = open_source(source)
    (chosen, *_) = choose_avatars(avatar, library)
    identity = library.find(chosen)
    return Publisher(SenderConfig(), opened, library.load(identity), identity)


def keep_folder(given: Path | None, preferences: Preferences) -> Path:
    """Where pictures and recordings go."""
    if given is not None:
        return given
    return Path(preferences.keep_in) if preferences.keep_in else default_keep_folder()


def look(
    config: ViewConfig,
    library: AvatarLibrary,
    publisher: Publisher | None,
    stopping: Stopping,
    *,
    kept: PreferencesFile | None = None,
) -> dict[str, Any]:
    """Stay in the room of the configuration.

    Args:
        config: What to show, and how.
        library: The avatars of this machine.
        publisher: Sends one's own face.
        stopping: How signals end it.
        kept: Where preferences go afterwards.

    Raises:
        See `View.run`.
    """
    looking = View(config, library, publisher=publisher)
    say(f"looking into room {config.link.room} at {config.link.url}")
    with stopping(looking.stop):
        result = looking.run()
    if kept is not None:
        _keep(kept, config, looking)
    return result


def ask_and_look(
    config: ViewConfig,
    library: AvatarLibrary,
    publisher: Publisher | None,
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
    from pica_client.ui.join_dialog import ask_where
    from pica_client.ui.window import Window

    with ExitStack() as stack:
        window = stack.enter_context(Window(config.viewer.title, config.viewer.size))
        while (link := ask_where(window, form)) is not None:
            stay = replace(config, link=link)
            looking = View(stay, library, publisher=publisher, window=window)
            try:
                with stopping(looking.stop):
                    result = looking.run()
            except RelayError as error:
                form.refuse(str(error))
                continue
            if kept is not None:
                _keep(kept, stay, looking)
            return result
    return {"frames_rendered": 0, "render_fps": 0.0}


def _keep(kept: PreferencesFile, config: ViewConfig, looking: View) -> None:
    """Remember how the user left it."""
    state = looking.last_controls
    before = kept.load()
    folder = config.viewer.keep_in
    kept.save(
        replace(
            before,
            layout=before.layout if state is None else state.layout,
            show_statistics=before.show_statistics if state is None else state.show_statistics,
            window_size=looking.last_window_size or before.window_size,
            url=config.link.url,
            room=config.link.room,
            name=config.link.name,
            keep_in="" if folder == default_keep_folder() else str(folder.absolute()),
        )
    )
