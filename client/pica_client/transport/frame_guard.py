"""What may stand between a link and its owner: something that seals frames and opens them.

A `Link` that is given one asks it before a frame goes out and before an event is handed on, and
carries its whispers. It knows no more about encryption; `pica_client.e2ee.guard` is what there is.
"""

from typing import Any, Protocol

from pica_protocol.frames import Frame
from pica_protocol.session import ClientEvent


class FrameGuard(Protocol):
    """Stands between the session of a link and everybody else on this side."""

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
