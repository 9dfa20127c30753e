"""What can go wrong with sealed payloads and keys.

    SealError
    ├── SecretFileError     the file with the room secret cannot be read or written
    ├── NoteError           a message about keys that is none, or not from one with the secret
    └── OpenError           a sealed payload that does not open
        ├── MalformedFrameError   too short, or no header
        ├── UnknownKeyError       sealed with a key that we do not have
        ├── ReplayedFrameError    its counter has been seen, or is too old to tell
        └── ForgedFrameError      header or payload are not what the sender sealed

Of an `OpenError` a receiver learns no more than its kind: what is refused is dropped and counted.
"""

from pica_client.e2ee.status import SealState
from pica_client.errors import ClientError


class SealError(ClientError):
    """Root of the errors of end-to-end encryption."""


class SecretFileError(SealError):
    """The secret cannot be used: names the file and the fix."""


class NoteError(SealError):
    """A message about keys cannot be trusted.

    Attributes:
        state: What it shows of its sender, if anything.
    """

    def __init__(self, message: str, state: SealState | None = None) -> None:
        super().__init__(message)
        self.state = state


class OpenError(SealError):
    """A sealed payload does not open."""


class MalformedFrameError(OpenError):
    """The bytes are no sealed payload."""


class UnknownKeyError(OpenError):
    """The key is not here, or not here any more."""


class ReplayedFrameError(OpenError):
    """The frame came before, or is older than the replay window."""


class ForgedFrameError(OpenError):
    """The authentication tag does not fit."""
