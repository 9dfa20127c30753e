"""Ranges of numbers among the settings, written beside the field that they belong to."""

from dataclasses import dataclass
from typing import Any, get_type_hints

from pica_server.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class Range:
    """The least and the largest value of a setting; stands in the ``Annotated`` of its field."""

    low: float
    high: float


def check_ranges(config: Any, table: str = "") -> None:
    """Check every number of a group of settings against its range.

    Raises:
        ConfigurationError: One is outside; names its flag, in ``table``, the range and the value.
    """
    for name, hint in get_type_hints(type(config), include_extras=True).items():
        value = getattr(config, name)
        for mark in getattr(hint, "__metadata__", ()):
            if isinstance(mark, Range) and not (value is None or mark.low <= value <= mark.high):
                flag = f"--{table}{name}".replace("_", "-")
                raise ConfigurationError(f"{flag} must be in {mark.low}..{mark.high}, got {value}")
