"""The options of a command as it reads them, without running it."""

from collections.abc import Mapping, Sequence
from typing import Any

from pica_command.options import CommandLine
from pica_command.table import COMMANDS


def read_options(
    command: str, words: Sequence[str], environment: Mapping[str, str] | None = None
) -> Any:
    """Read words and variables into the options of a command that takes one dataclass."""
    given = CommandLine(command, COMMANDS[command], environment or {}, None).read(words)
    assert given is not None
    (options,) = given.values()
    return options
