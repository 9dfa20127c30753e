"""What keeps a relay from running, and the refusals its pure parts report.

RelayError
├── ConfigurationError   a setting that cannot work, or what it names: an address, a file, NATS
├── AdmissionError       a join without a token that allows it; carries the close code
├── StoreError           the avatar store cannot be used
│   └── StoreRefusalError   a peer is refused; carries the close code
└── OutboxFullError      more control messages than a peer that reads would leave waiting
"""

from pica_protocol.errors import CloseCode


class RelayError(Exception):
    """Root of the errors of this package."""

    exit_code = 2


class ConfigurationError(RelayError, ValueError):
    """A setting cannot work, or what it names cannot be used: names the setting and the fix."""


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


class OutboxFullError(RelayError):
    """A peer lets control messages pile up."""
