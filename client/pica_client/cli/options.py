"""What the options of several commands share."""

from pica_client.errors import OptionError

CONNECT_TIMEOUT_S = 3.0
"""How long a command tries to reach a relay before it gives up, unless told to wait."""


def connect_timeout_s(*, wait: bool, seconds: float) -> float | None:
    """How long to try to reach a relay: until the time that the command was given is over, if it is
    to wait; None is for ever."""
    return (seconds or None) if wait else CONNECT_TIMEOUT_S


def check_voice(source: str, voice: str | None) -> None:
    """Refuse a face that only a voice moves, where there is none.

    Raises:
        OptionError: Says what to add.
    """
    if source == "voice" and voice in (None, "none"):
        raise OptionError("source voice needs --voice mic or a WAV file")


def parse_size(text: str) -> tuple[int, int]:
    """`960x540` as columns and rows."""
    columns, _, rows = text.partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise OptionError(f"size is {text!r}; write COLUMNSxROWS, such as 960x540")
    size = int(columns), int(rows)
    if not all(16 <= length <= 8192 for length in size):
        raise OptionError(f"size is {text}; 16 to 8192 columns and rows are allowed")
    return size
