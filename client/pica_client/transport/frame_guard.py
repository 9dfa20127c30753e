"""What may stand between a link and its owner: something that seals frames and opens them.

A `Link` that is given one asks it before a frame goes out and before an event is handed on, and
carries its whispers. It knows no more about encryption; `pica_client.e2ee.guard` is what there is.
"""

import binascii
import json
from base64 import urlsafe_b64decode
from typing import Any, Protocol

from pica_client.e2ee.status import SealStatus
from pica_protocol.frames import Frame
from pica_protocol.session import ClientEvent


class FrameGuard(Protocol):
    """Stands between the session of a link and everybody else on this side."""

    @property
    def status(self) -> SealStatus:
        """Whose frames are opened and whose are not, and the code to read aloud. Any thread may
        ask; never changed, only replaced."""

    def begin(self, room: str, name: str) -> None:
        """We are about to join a room, and will be shown under this name.

        Asked before each join; what the relay answers cannot change it.
        """

    def seal(self, frame: Frame) -> bytes:
        """Return the payload to send instead of the frame's own.

        Asked once for each frame, when its header is final.
        """

    def receive_event(self, event: ClientEvent, now: float) -> list[ClientEvent]:
        """Take an event of the session and return what the owner of the link gets instead."""

    def messages_to_send(self, now: float) -> list[tuple[str, bytes]]:
        """Take the whispers that must go out now: peer ids and data.

        They go before every frame that was sealed before this call.
        """

    def next_timer(self) -> float | None:
        """Return when `handle_timer` is due, or None."""

    def handle_timer(self, now: float) -> None:
        """It is that time."""

    def stats(self) -> dict[str, Any]:
        """Return what was sealed, opened and refused so far."""


def shown_name(name: str, token: str) -> str:
    """Return the name that others are shown: that of the join token, if it has one, or the given
    one. Who signed the token does not matter here: we ask what our own pass says of us."""
    try:
        claims = json.loads(urlsafe_b64decode(token.split(".")[1] + "=="))
        said = claims.get("name", "")
    except (IndexError, binascii.Error, ValueError, AttributeError):
        said = ""
    return said if isinstance(said, str) and said else name
