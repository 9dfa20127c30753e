"""Whether a refusal is the end of a link. Pure.

What nobody mends by waiting is. The rest may pass (`pica_protocol.errors.may_pass`): one's own
ghost holds the place, a key file or a clock is just being mended. Who joins for the first time is
told at once all the same; who was in the room tries again for `RETURN_S`.
"""

from typing import Final

from pica_client.errors import OptionError, RelayError, RelayRefusedError, RelayUnreachableError
from pica_protocol.errors import CloseCode, is_worth_retrying, may_pass
from pica_protocol.session import Closed

RETURN_S: Final = 60.0
"""So long who was in the room is refused before that is final (chosen: ghosts are gone after 20 s,
and a clock or a key file is mended within a minute or not by itself)."""


def breaks_protocol(closed: Closed) -> bool:
    """Say whether a connection ended because somebody broke the protocol."""
    return closed.code in (CloseCode.MALFORMED, CloseCode.UNEXPECTED_MESSAGE)


def refusal_of(url: str, closed: Closed) -> RelayRefusedError | None:
    """Return what it means that a relay closed a connection, or None: come back at once."""
    # What we could not read may have been a passing fault of the relay: try again, slower.
    if is_worth_retrying(closed.code) or (breaks_protocol(closed) and not closed.is_remote):
        return None
    return RelayRefusedError(
        f"{url}: the relay said no: {closed.reason or 'no reason'} (code {closed.code})",
        may_pass=may_pass(closed.code),
        code=closed.code,
    )


class Refusals:
    """Remembers whether we were in the room, and since when we are refused."""

    def __init__(self) -> None:
        self._was_in = False
        self._since_s: float | None = None

    def note_joined(self) -> None:
        """Note that we are in."""
        self._was_in, self._since_s = True, None

    def receive(self, error: RelayError | OptionError, now: float, *, is_last: bool) -> None:
        """Take what went wrong at one address, and raise it if it is the end.

        Args:
            error: What went wrong; with `OptionError`, one of our own files.
            is_last: Whether no other address is left to be tried at once.
        """
        if isinstance(error, RelayUnreachableError):
            return
        if isinstance(error, RelayRefusedError) and not error.may_pass:
            raise error
        if not is_last:
            return
        if not self._was_in:
            raise error
        if self._since_s is None:
            self._since_s = now
        if now - self._since_s >= RETURN_S:
            raise type(error)(f"{error}; tried to come back for {RETURN_S:g} s") from error
