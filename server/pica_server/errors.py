"""What keeps a relay from running, and the two refusals its pure parts report.

RelayError
├── ConfigurationError   a setting that cannot work: names field, value and range
├── ListenError          the address cannot be bound
├── RoomFullError        one peer more than the room takes
└── OutboxFullError      more control messages than a peer that reads would leave waiting
"""


class RelayError(Exception):
    """Root of the errors of this package."""

    exit_code = 2


class ConfigurationError(RelayError, ValueError):
    """A setting cannot work: names the field, the value and the allowed range."""


class ListenError(RelayError):
    """The relay cannot listen on its address: names it and the fix."""


class RoomFullError(RelayError):
    """The room has as many peers as it may."""


class OutboxFullError(RelayError):
    """A peer lets control messages pile up."""
