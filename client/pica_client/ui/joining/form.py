"""The form that asks where to and as whom, without a window: what was typed, what is wrong. Pure.

form = JoinForm(Fields(url="ws://127.0.0.1:8765"))
form.obey(replace(form.fields, room="standup"))
form.obey(JoinOrder.JOIN)
form.outcome                    # "join" once the fields can be right
"""

from dataclasses import dataclass, field, replace
from enum import Enum, auto
from pathlib import Path
from typing import Literal

from pica_client.errors import OptionError
from pica_client.publish.own_face import FaceChoice
from pica_client.sources.performances import PERFORMANCES
from pica_client.transport.config import LinkConfig
from pica_client.ui.joining.trouble import Trouble, explain
from pica_client.voice.sound.settings import SoundSettings
from pica_protocol.invite import is_link, parse_link

MAX_CHARACTERS = 2048
"""Characters that a field takes; a token may be that long."""
SECRETS = ("token",)
"""Fields that are shown as stars and kept nowhere."""
SOURCES: tuple[tuple[str, str], ...] = (
    *((f"performance:{name}", f"Play: {name}") for name in PERFORMANCES),
    ("livelink", "iPhone: Live Link Face"),
    ("vmc", "VTuber program: VMC"),
    ("webcam", "Webcam"),
    ("voice", "None: my voice moves the mouth"),
    ("", "Watch only"),
)
"""Face sources to choose from, and what they are called."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Fields:
    """What the user has typed and chosen."""

    url: str = ""
    room: str = ""
    name: str = ""
    token: str = ""
    ca_file: str = ""
    secret_file: str = ""
    avatar: str = ""
    """A shipped avatar by its name, or a file; empty takes one by the user's name."""
    source: str = ""
    """What plays the user's face; empty only watches."""
    voice: str = "none"
    """Whose voice is sent, for `voice.source.open_voice`."""
    sound: SoundSettings = field(default_factory=SoundSettings)

    def __repr__(self) -> str:
        return f"Fields(url={self.url!r}, room={self.room!r}, name={self.name!r})"

    def invited(self) -> "Fields":
        """The fields as an invite link fills them that was put into the first one.

        Raises:
            ValueError: It is no good link.
        """
        invite = parse_link(self.url)
        return replace(self, url=invite.url, room=invite.room, token=invite.token)


class JoinOrder(Enum):
    """What a button of the form asks for."""

    JOIN = auto()
    LEAVE = auto()
    TRY_SOUND = auto()
    """The meters are shown."""
    TEST_SOUND = auto()


class JoinForm:
    """Fields, and what is wrong with them.

    Args:
        given: What stands in the fields at first.
        base: What of the connection is not asked for.

    Attributes:
        trouble: What is wrong, for people; None when nothing is known to be.
        outcome: "asking" until the user wants to join or to leave.
    """

    def __init__(self, given: Fields, *, base: LinkConfig | None = None) -> None:
        self.fields = given
        self.trouble: Trouble | None = None
        self.outcome: Literal["asking", "join", "leave"] = "asking"
        self._base = base or LinkConfig()

    def obey(self, order: Fields | JoinOrder) -> None:
        """Take what was typed, or what a button asks for."""
        if isinstance(order, Fields):
            self._take(order)
        elif order is JoinOrder.LEAVE:
            self.outcome = "leave"
        elif order is JoinOrder.JOIN:
            try:
                self.link()
            except OptionError as error:
                self.refuse(error)
            else:
                self.trouble, self.outcome = None, "join"

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
            ca_file=_path(typed.ca_file) if url.startswith("wss://") else None,
            secret_file=_path(typed.secret_file),
            room=typed.room.strip(),
            name=typed.name.strip(),
            token=token,
            token_file=None if token else self._base.token_file,
        )

    def face(self, base: FaceChoice) -> FaceChoice:
        """The face that was asked for; what is not asked is as in `base`."""
        return replace(base, source=self.fields.source, avatar=self.fields.avatar.strip() or None)

    def refuse(self, error: BaseException) -> None:
        """Ask again, saying why."""
        self.trouble, self.outcome = explain(error), "asking"

    def ask_again(self) -> None:
        """Ask again: the user has changed their mind."""
        self.trouble, self.outcome = None, "asking"

    def _take(self, fields: Fields) -> None:
        if fields == self.fields:
            return
        self.fields, self.trouble = fields, None
        if is_link(fields.url):
            try:
                self.fields = fields.invited()
            except ValueError as error:
                self.trouble = Trouble(f"{error}.")


def _path(text: str) -> Path | None:
    return Path(text.strip()).expanduser() if text.strip() else None
