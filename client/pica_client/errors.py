"""What can go wrong in a sender or a receiver that its user can mend.

    ClientError
    ├── OptionError         an option, or a combination of them, that makes no sense; a name of an
    │                       avatar that is neither shipped nor in the given files
    ├── SourceError         a tracker, recording or performance that cannot be read
    ├── ShaderError         shader text that is wrong, or that a driver does not take
    ├── VoiceError          sound that cannot be opened, encoded, decoded or played
    ├── SealError           end-to-end encryption: a secret, a message about keys, a sealed payload
    ├── RelayError          the way to the relay
    │   ├── RelayUnreachableError   no answer at that address
    │   └── RelayRefusedError       the relay refuses us
    └── CallProcessError    a process of a demo or bench that did not do its part

``exit_code`` is what the ``pica`` command ends with when the error reaches it (see
`pica_core.errors`).
"""

import pica_core.errors


class ClientError(Exception):
    """Root of the errors of this package: the input or the machine is at fault."""

    exit_code = 2


class OptionError(ClientError):
    """An option is out of range: names the option, the value and the limit."""


def check_ranges(owner: object, **ranges: tuple[float, float]) -> None:
    """Refuse options out of range; see `pica_core.errors.check_ranges`."""
    pica_core.errors.check_ranges(owner, OptionError, **ranges)


class SourceError(ClientError):
    """The source cannot be read: names the file, the line or column, and the fix."""


class ShaderError(ClientError):
    """Shader text cannot be composed or compiled: names the file, and quotes the driver."""


class VoiceError(ClientError):
    """Sound cannot be used: names the file, device or packet, and the limit or the fix."""


class SealError(ClientError):
    """A secret cannot be used, names the file and the fix; or a message about keys cannot be
    trusted, or a sealed payload does not open: those are dropped and counted."""


class RelayError(ClientError):
    """The relay cannot be used."""


class RelayUnreachableError(RelayError):
    """No answer: names the address and how to start a relay."""


class RelayRefusedError(RelayError):
    """The relay closed the door: names its close code and reason.

    Attributes:
        may_pass: Whether it may be open again soon, without anybody changing anything.
        code: The relay's close code; None when what answered was no relay.
    """

    def __init__(self, message: str, *, may_pass: bool = True, code: int | None = None) -> None:
        super().__init__(message)
        self.may_pass = may_pass
        self.code = code


class CallProcessError(ClientError):
    """A process of a demo or bench ended early: names it and quotes its last words.

    Attributes:
        exit_code: 2 when that is what the process ended with: then input or machine are at fault.
    """

    def __init__(self, message: str, *, exit_code: int = 1) -> None:
        super().__init__(message)
        self.exit_code = exit_code
