"""The form that asks where to go and with which identity, without a window. Pure.

form = JoinForm(ViewState(url="ws://127.0.0.1:8765"), link_of)
form.state.room = "standup"
form.obey("join")
form.outcome                    # "join" once the fields can be right
"""

from collections.abc import Callable
from typing import Literal

from pica_client.errors import OptionError
from pica_client.sources.performances import PERFORMANCES
from pica_client.transport.config import LinkConfig
from pica_client.ui.state import ViewState
from pica_client.ui.trouble import Trouble, explain
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


JoinRequest = Literal["typed", "join", "leave", "show meters", "test sound"]
"""What the form asks for; "typed" is after each change of a field."""


class JoinForm:
    """What is typed into a `ViewState`, and what is wrong with it.

    Args:
        state: What stands in the fields at first; panels write into it.
        link_of: Gives the connection that the state asks for.

    Attributes:
        trouble: What is wrong, for people; None when nothing is known to be.
        outcome: "asking" until the user wants to join or to leave.
    """

    def __init__(self, state: ViewState, link_of: Callable[[ViewState], LinkConfig]) -> None:
        self.state = state
        self.trouble: Trouble | None = None
        self.outcome: Literal["asking", "join", "leave"] = "asking"
        self._link_of = link_of

    def obey(self, request: JoinRequest) -> None:
        """Take what a button of the form asks for."""
        if request == "leave":
            self.outcome = "leave"
        elif request == "typed":
            self.trouble = None
            if is_link(self.state.url):
                try:
                    follow_invite(self.state, self.state.url)
                except ValueError as error:
                    self.trouble = Trouble(f"{error}.")
        elif request == "join":
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
    state.url = state.invited_url = invite.url
    state.room, state.token = invite.room, invite.token
