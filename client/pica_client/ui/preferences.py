"""What a user wants to find again in the next call: one small file in the platform's place for it.

A damaged file is no reason not to start: it is said once, and defaults are taken. No secret is ever
in it: the last address is kept without user, password or query, tokens are not kept at all.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit, urlunsplit

from pica_client.errors import OptionError
from pica_client.output import say
from pica_client.render.seats import LAYOUTS, Layout
from pica_client.ui.settings import Settings
from pica_client.user_folders import make_private, preferences_folder
from pica_client.voice.sound.settings import SoundSettings
from pica_core.files import replacing

FILE_NAME = "preferences.json"
MAX_FILE_BYTES = 65_536
MAX_TEXT = 1024
"""Characters of an address, a name or a folder."""
MIN_SIDE, MAX_SIDE = 160, 8192


@dataclass(frozen=True, kw_only=True, slots=True)
class Preferences:
    """What is kept from call to call."""

    layout: Layout = "arc"
    show_statistics: bool = False
    settings: Settings = field(default_factory=Settings)
    sound: SoundSettings = field(default_factory=SoundSettings)
    has_seen_hint: bool = False
    """Whether what one needs to know in the first call was dismissed."""
    window_size: tuple[int, int] = (960, 540)
    """Columns and rows, in the screen's units."""
    url: str = ""
    """The relay of the last call; empty before the first."""
    room: str = ""
    name: str = ""
    """What the user was called in it."""
    keep_in: str = ""
    """Folder for pictures and recordings; empty is the system's for each of them."""
    ca_file: str = ""
    """File of certificates to trust."""
    secret_file: str = ""
    """File with the room secret; the secret itself is not kept."""
    avatar: str = ""
    """The user's own, by name or file; empty takes one by the name."""
    source: str | None = None
    """What plays the user's face; empty only watches, None has not been chosen yet."""
    voice: str | None = None
    """Whose voice is sent; None has not been chosen yet."""

    def __post_init__(self) -> None:
        if self.layout not in LAYOUTS:
            raise ValueError(f"layout is {self.layout!r}; it may be {', '.join(LAYOUTS)}")
        for name in ("show_statistics", "has_seen_hint"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(f"{name} is {getattr(self, name)!r}; true or false")
        sides = self.window_size
        if not (isinstance(sides, tuple) and len(sides) == 2) or not all(
            type(side) is int and MIN_SIDE <= side <= MAX_SIDE for side in sides
        ):
            raise ValueError(f"window_size is {sides!r}; two of {MIN_SIDE} to {MAX_SIDE}")
        texts = ("url", "room", "name", "keep_in", "ca_file", "secret_file", "avatar")
        for name in (*texts, "source", "voice"):
            value = getattr(self, name)
            if name not in texts and value is None:
                continue
            if not isinstance(value, str) or len(value) > MAX_TEXT:
                raise ValueError(f"{name} is no text of up to {MAX_TEXT} characters")
            if name in ("url", "room", "name") and not value.isprintable():
                raise ValueError(f"{name} holds signs that cannot be shown")


def fit_side(side: int) -> int:
    """The nearest side of a window that is kept."""
    return min(max(side, MIN_SIDE), MAX_SIDE)


class PreferencesFile:
    """The file of one user.

    Args:
        folder: Where it is; by default `preferences_folder`.
        warn: Called, at most once, with what is wrong with it.
    """

    def __init__(self, folder: Path | None = None, *, warn: Callable[[str], None] = say) -> None:
        self.path = (preferences_folder() if folder is None else folder) / FILE_NAME
        self._warn = warn

    def load(self) -> Preferences:
        """What is in the file; defaults if there is none, or none that can be used."""
        try:
            with self.path.open("rb") as file:
                content = file.read(MAX_FILE_BYTES + 1)
            if len(content) > MAX_FILE_BYTES:
                raise ValueError(f"it is larger than {MAX_FILE_BYTES} bytes")
            return _from_json(json.loads(content))
        except FileNotFoundError:
            return Preferences()
        except (OSError, ValueError, RecursionError, OptionError) as error:
            reason = error.strerror if isinstance(error, OSError) else str(error)
            self._warn(f"{self.path}: preferences cannot be used, taking defaults: {reason}")
            return Preferences()

    def save(self, preferences: Preferences) -> None:
        """Replace the file, whole or not at all. When it cannot be written, the user is told and
        the call goes on."""
        kept = asdict(preferences) | {"url": without_secrets(preferences.url)}
        text = json.dumps(kept, indent=2) + "\n"
        try:
            make_private(self.path.parent)
            with replacing(self.path) as unfinished:
                unfinished.touch(0o600)
                unfinished.write_text(text)
        except OSError as error:
            self._warn(f"{self.path}: preferences cannot be kept: {error.strerror or error}")


def without_secrets(url: str) -> str:
    """An address without user, password, query and fragment: there might be a token in them."""
    try:
        parts = urlsplit(url)
        host = parts.netloc.rpartition("@")[2]
        return urlunsplit((parts.scheme, host, parts.path, "", ""))
    except ValueError:
        return ""


def _from_json(content: Any) -> Preferences:
    """Preferences out of a file.

    Raises:
        ValueError, OptionError: Something in it is not as it must be.
    """
    values = _known(Preferences, content)
    for name, kind in (("settings", Settings), ("sound", SoundSettings)):
        if name in values:
            values[name] = kind(**_known(kind, values[name]))
    if isinstance(values.get("window_size"), list):
        values["window_size"] = tuple(values["window_size"])
    return Preferences(**values)


def _known(kind: type[Preferences | Settings | SoundSettings], content: Any) -> dict[str, Any]:
    """The values of a kind; what a later version has put beside them is left out."""
    if not isinstance(content, dict):
        raise ValueError(f"{content!r:.50} is no object of {kind.__name__}")
    names = {field.name for field in fields(kind)}
    return {name: value for name, value in content.items() if name in names}
