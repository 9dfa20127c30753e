"""What can go wrong with sealed payloads and keys.

SealError
├── SecretFileError    the file with the room secret cannot be read or written
├── KeyMessageError    a message about keys that is not from a member, or not for us
└── OpenError          a payload that is not what its sender sealed
"""

from pica_client.errors import ClientError


class SealError(ClientError):
    """Root of the errors of end-to-end encryption."""


class SecretFileError(SealError):
    """The secret cannot be used: names the file and the fix."""


class KeyMessageError(SealError):
    """A message about keys cannot be trusted."""


class OpenError(SealError):
    """A sealed payload does not open; it is dropped and counted, and not reported further."""
