"""What a link without a window tells its user: that it is in the room, was lost, and is back."""

from collections.abc import Callable
from dataclasses import dataclass

from pica_protocol.errors import is_worth_retrying
from pica_protocol.messages import Joined
from pica_protocol.session import ClientEvent, Closed


@dataclass(eq=False)
class LinkNews:
    """Says a line when the connection to the relay comes and goes.

    A connection that never led into the room is no news: the link raises why, or tries on.
    """

    _joined: str
    """What to say once we are in the room."""
    _say: Callable[[str], None]
    _has_been_there: bool = False
    _lost_s: float | None = None

    def receive_event(self, event: ClientEvent, now: float) -> None:
        """Take an event of the link's session at `now`, seconds."""
        match event:
            case Joined() if not self._has_been_there:
                self._has_been_there = True
                self._say(self._joined)
            case Joined() if self._lost_s is not None:
                self._say(f"back in the room after {now - self._lost_s:.1f} s")
                self._lost_s = None
            case Closed(code=code, reason=reason) if (
                self._has_been_there and self._lost_s is None and is_worth_retrying(code)
            ):
                self._lost_s = now
                why = f" ({reason})" if reason else ""
                self._say(f"connection to the relay lost{why}; coming back by itself")
            case _:
                pass
