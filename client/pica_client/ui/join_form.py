"""The form that asks where to: address, room, name, token. Pure; `join_dialog` shows it.

form = JoinForm(Fields(url="ws://127.0.0.1:8765"))
form.receive(TextTyped("a"))
form.outcome                    # "join" once Enter was pressed on fields that can be right
"""

import textwrap
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal

from pica_client.errors import OptionError
from pica_client.transport.config import LinkConfig
from pica_client.ui.controls import CloseWanted, InputEvent, KeyPressed, MousePressed, TextTyped
from pica_client.ui.hud import type_size_px
from pica_client.ui.text_raster import OverlayItem, form_line_at, item_size_px

MAX_CHARACTERS = 2048
"""Characters that a field takes; a token may be that long."""
CARET = "|"
HIDDEN = "*"
TITLES = {"url": "Relay", "room": "Room", "name": "Your name", "token": "Token"}
HINT = "Tab next   Enter join   Ctrl+V paste   Esc leave"
ERROR_COLUMNS = 72
ERROR_LINES = 3
FIRST_FIELD_LINE = 1


@dataclass(frozen=True, kw_only=True, slots=True)
class Fields:
    """What the user has typed."""

    url: str = ""
    room: str = ""
    name: str = ""
    token: str = ""

    def __repr__(self) -> str:
        return f"Fields(url={self.url!r}, room={self.room!r}, name={self.name!r})"


NAMES = tuple(field.name for field in fields(Fields))


class JoinForm:
    """Fields, which of them is in use, and what is wrong.

    Attributes:
        fields: What has been typed.
        error: What is wrong, for people; empty when nothing is known to be.
        outcome: "asking" until the user wants to join or to leave.
    """

    def __init__(
        self, given: Fields, *, base: LinkConfig | None = None, ca_file: Path | None = None
    ) -> None:
        """Begin with given fields.

        Args:
            given: What stands in the fields at first.
            base: What of the connection is not asked for.
            ca_file: Whom to trust if the address is wss://.
        """
        self.fields = given
        self.error = ""
        self.outcome: Literal["asking", "join", "leave"] = "asking"
        self._base = base or LinkConfig()
        self._ca_file = ca_file
        # Where something is still missing one wants to type.
        empty = [name for name in NAMES[:3] if not getattr(given, name)]
        self._in_use = NAMES.index(empty[0]) if empty else 0

    def receive(self, event: InputEvent, *, clipboard: str = "") -> None:
        """Take one event; `clipboard` is what would be pasted."""
        match event:
            case CloseWanted():
                self.outcome = "leave"
            case TextTyped(text=text):
                self._type(text)
            case KeyPressed(key="V", has_control=True):
                self._type(clipboard)
            case KeyPressed(key="U", has_control=True):
                self._set("")
            case KeyPressed(key="Backspace"):
                self._set(self._value[:-1])
            case KeyPressed(key="Tab", has_shift=back):
                self._move(-1 if back else 1)
            case KeyPressed(key="Down"):
                self._move(1)
            case KeyPressed(key="Up"):
                self._move(-1)
            case KeyPressed(key="Enter", is_repeat=False):
                self._submit()
            case KeyPressed(key="Escape"):
                self.outcome = "leave"
            case _:
                pass

    def click(self, event: MousePressed, item: OverlayItem) -> None:
        """Use the field that was clicked on, in the form as it is drawn."""
        chosen = form_line_at(item, event.y_px) - FIRST_FIELD_LINE
        if 0 <= chosen < len(NAMES):
            self._in_use = chosen

    def link(self) -> LinkConfig:
        """The connection that was asked for.

        Raises:
            OptionError: A field cannot be right; names it.
        """
        typed = self.fields
        url, token = typed.url.strip(), typed.token.strip()
        return replace(
            self._base,
            url=url,
            ca_file=self._ca_file if url.startswith("wss://") else None,
            room=typed.room.strip(),
            name=typed.name.strip(),
            token=token,
            token_file=None if token else self._base.token_file,
        )

    def refuse(self, reason: str) -> None:
        """Ask again, saying why."""
        self.error, self.outcome = reason, "asking"

    def item(self, size: tuple[int, int], *, is_caret_shown: bool = True) -> OverlayItem:
        """The form in the middle of a picture of `size`, columns and rows."""
        lines: list[tuple[str, ...]] = [("Join a call",)]
        for index, name in enumerate(NAMES):
            value = getattr(self.fields, name)
            shown = HIDDEN * len(value) if name == "token" else value
            is_used = index == self._in_use
            lines.append((TITLES[name], shown + (CARET if is_used and is_caret_shown else "")))
        lines.append((HINT,))
        lines += [(line,) for line in _wrapped(self.error)]
        item = OverlayItem(
            key="join",
            lines=tuple(lines),
            x_px=0,
            y_px=0,
            style="form",
            size_px=type_size_px(size[1]),
            tone="alert" if self.error else "plain",
            highlight=FIRST_FIELD_LINE + self._in_use,
        )
        width, height = item_size_px(item)
        return replace(item, x_px=(size[0] - width) / 2, y_px=(size[1] - height) / 2)

    @property
    def _value(self) -> str:
        return str(getattr(self.fields, NAMES[self._in_use]))

    def _set(self, value: str) -> None:
        self.fields = replace(self.fields, **{NAMES[self._in_use]: value[:MAX_CHARACTERS]})
        self.error = ""

    def _type(self, text: str) -> None:
        # What is pasted often ends with a line; what has several is no address.
        self._set(self._value + "".join(char for char in text if char.isprintable()))

    def _move(self, step: int) -> None:
        self._in_use = (self._in_use + step) % len(NAMES)

    def _submit(self) -> None:
        try:
            self.link()
        except OptionError as error:
            self.error = str(error)
            for index, name in enumerate(NAMES):
                if self.error.startswith(name):
                    self._in_use = index
            return
        self.error, self.outcome = "", "join"


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, ERROR_COLUMNS, max_lines=ERROR_LINES, placeholder=" …")
