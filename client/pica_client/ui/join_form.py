"""The form that asks where to go and under which identity, and what went wrong with joining. Pure.

    form = JoinForm(ViewState(url="ws://127.0.0.1:8765"), link_of)
    form.state.room = "standup"
    form.join()
    form.outcome                    # "join" once the fields can be right

Errors are put into a person's words: what it is, and what helps. The raw error is kept as details.
"""

import socket
import ssl
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from websockets.exceptions import InvalidHandshake

from pica_client.errors import (
    AvatarLookupError,
    OptionError,
    RelayRefusedError,
    RelayUnreachableError,
    SourceError,
)
from pica_client.sources.performances import PERFORMANCES
from pica_client.transport.config import LinkConfig
from pica_client.ui.state import ViewState
from pica_core.errors import AvatarFileError
from pica_protocol.errors import CloseCode
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


@dataclass(frozen=True, slots=True)
class Trouble:
    """Why one could not join."""

    what: str
    """What is wrong, one sentence."""
    remedy: str = ""
    """What helps, one or two sentences."""
    details: str = ""
    """The raw error."""


REFUSALS: dict[int, tuple[str, str]] = {
    CloseCode.WRONG_VERSION: (
        "The relay runs another version of PiCA.",
        "Update PiCA on this computer, or ask the relay's operator to update it.",
    ),
    CloseCode.ROOM_FULL: (
        "The room is full.",
        "Wait until a participant leaves, or use another room.",
    ),
    CloseCode.RELAY_FULL: ("The relay is full.", "Try again in a few minutes."),
    CloseCode.BUSY: ("The relay is busy.", "Try again in a moment."),
    CloseCode.TOO_MANY: (
        "Too many people from your network are on this relay.",
        "Close other PiCA windows, or ask the relay's operator for a higher limit.",
    ),
    CloseCode.UNAUTHORIZED: (
        "You need a valid token for this room.",
        "Ask your host for a fresh invite link. Tokens expire, and hold for one room only.",
    ),
    CloseCode.FORBIDDEN: (
        "Your token does not allow this.",
        "Choose to watch only or to wear another avatar, or ask your host for another invite link.",
    ),
    CloseCode.REPLACED: (
        "You joined this room from somewhere else.",
        "Leave there first, or ask for an invite link of your own: each person needs one.",
    ),
    CloseCode.REMOVED: ("You were removed from the room.", "Ask the host whether you may return."),
    CloseCode.TOO_FAST: ("The relay has stopped you for sending too much.", "Try again later."),
}
"""What close codes mean, and what helps."""

FIELDS: dict[str, tuple[str, str]] = {
    "url": (
        "This is no address of a relay.",
        "It looks like wss://relay.example or ws://192.168.0.7:8765; an invite link is taken, too.",
    ),
    "room": ("No room can be called so.", "Use up to 64 letters A to Z, digits, and _ . -"),
    "name": (
        "Please enter your name.",
        "It may have up to 64 letters, fewer in some scripts.",
    ),
    "token": ("This cannot be a token.", "Copy it again, or ask your host for an invite link."),
    "ca-file": ("The CA file cannot be used.", "Check the path under More."),
    "secret-file": ("The room secret cannot be read.", "Check the path under More."),
}
"""What is wrong with a field, by its name, and what helps."""

_CHECK_ADDRESS = "Check the address for typing errors, or ask your host for an invite link."
_NOT_A_RELAY = ("Something else answers at this address, not a PiCA relay.", _CHECK_ADDRESS)
CAUSES: tuple[
    tuple[type[BaseException] | tuple[type[BaseException], ...], tuple[str, str]], ...
] = (
    (
        ssl.SSLCertVerificationError,
        (
            "The relay's certificate is not trusted.",
            "Check the address. If the relay has a certificate of its own, ask for its CA file and"
            " give it under More.",
        ),
    ),
    (ssl.SSLError, ("The relay does not encrypt its connections.", "Try ws:// instead of wss://.")),
    (socket.gaierror, ("There is no computer of that name.", _CHECK_ADDRESS)),
    ((InvalidHandshake, EOFError, RelayRefusedError), _NOT_A_RELAY),
    (
        BaseException,
        (
            "No relay answers at this address.",
            "Check the address, that you are online and that the relay runs. Both ends must allow"
            " this port in their firewall.",
        ),
    ),
)
"""What the network's own errors mean, and what helps; the first that fits."""


def explain(error: BaseException) -> Trouble:
    """An error that came of joining, in a person's words."""
    what, remedy = _words(error)
    return Trouble(what, remedy, "" if what == str(error) else str(error))


def _words(error: BaseException) -> tuple[str, str]:
    match error:
        case RelayRefusedError(code=int(code)) if code in REFUSALS:
            return REFUSALS[code]
        case RelayRefusedError(code=int()):
            return "The relay said no.", _CHECK_ADDRESS
        case RelayRefusedError() | RelayUnreachableError():
            while error.__cause__ is not None:
                error = error.__cause__
            return next(words for kinds, words in CAUSES if isinstance(error, kinds))
        case SourceError():
            return "Your face cannot be read from this source.", "Choose another face source."
        case AvatarLookupError():
            return "This avatar is not on this computer.", "Choose one of the pictures, or a file."
        case AvatarFileError():
            return "This avatar file cannot be used.", "Choose another avatar."
        case OptionError():
            field = str(error).partition(" ")[0]
            return FIELDS.get(field, (str(error), ""))
    return "Joining did not work.", "Try again; the details say what happened."


class JoinForm:
    """What is typed into a `ViewState`, and what is wrong with it.

    Args:
        state: What stands in the fields at first; panels write into it.
        link_of: Gives the connection that the state asks for.

    Attributes:
        trouble: What is wrong, for people; None when nothing is known to be.
        outcome: "asking" until the user wants to join or to leave.
        shows_meters: The microphone is to be heard by its owner alone.
        wants_test: A test sound is to be played.
    """

    def __init__(self, state: ViewState, link_of: Callable[[ViewState], LinkConfig]) -> None:
        self.state = state
        self.trouble: Trouble | None = None
        self.outcome: Literal["asking", "join", "leave"] = "asking"
        self.shows_meters = self.wants_test = False
        self._link_of = link_of

    def typed(self) -> None:
        """A field has changed: an invite link in the first one fills in the others."""
        self.trouble = None
        if is_link(self.state.url):
            try:
                follow_invite(self.state, self.state.url)
            except ValueError as error:
                self.trouble = Trouble(f"{error}.")

    def join(self) -> None:
        """Join, if the fields can be right."""
        try:
            self._link_of(self.state)
        except OptionError as error:
            self.refuse(error)
        else:
            self.trouble, self.outcome = None, "join"

    def refuse(self, error: BaseException) -> None:
        """Ask again, saying why."""
        self.trouble, self.outcome = explain(error), "asking"

    def ask_again(self) -> None:
        """Ask again: the user has changed their mind."""
        self.trouble, self.outcome = None, "asking"


def follow_invite(state: ViewState, link: str) -> None:
    """Take relay, room and token from an invite link.

    Raises:
        ValueError: It is no good link.
    """
    invite = parse_link(link)
    state.url, state.room, state.token = invite.url, invite.room, invite.token
