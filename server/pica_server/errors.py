"""What keeps a relay from running, and the refusals its pure parts report.

RelayError
├── ConfigurationError   a setting that cannot work: names field, value and range
├── ListenError          the address cannot be bound
├── KeyFileError         the file of signing keys cannot be used
├── AdmissionError       a join without a token that allows it; carries the close code
├── StoreError           the avatar store cannot be used
│   └── StoreRefusalError   a peer is refused; carries the close code
├── ClusterError         the cluster cannot be joined
├── RoomFullError        one peer more than the room takes
└── OutboxFullError      more control messages than a peer that reads would leave waiting
"""

from pica_protocol.errors import CloseCode


class RelayError(Exception):
    """Root of the errors of this package."""

    exit_code = 2


class ConfigurationError(RelayError, ValueError):
    """A setting cannot work: names the field, the value and the allowed range."""


class ListenError(RelayError):
    """The relay cannot listen on its address: names it and the fix."""


class KeyFileError(RelayError):
    """The file of signing keys cannot be used: names the line and the fix."""


class AdmissionError(RelayError):
    """A peer may not do what its join asks for; ``code`` is what it is told."""

    def __init__(self, message: str, code: CloseCode) -> None:
        super().__init__(message)
        self.code = code


class StoreError(RelayError):
    """The avatar store cannot be used: names the place and the fix."""


class StoreRefusalError(StoreError):
    """The store refuses a request; ``code`` is what the peer is told."""

    def __init__(self, message: str, code: CloseCode) -> None:
        super().__init__(message)
        self.code = code


class ClusterError(RelayError):
    """The cluster cannot be joined: names the setting and the fix."""


class RoomFullError(RelayError):
    """The room has as many peers as it may."""


class OutboxFullError(RelayError):
    """A peer lets control messages pile up."""
