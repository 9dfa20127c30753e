"""Words of the command line become an object of options; what is wrong with them is one line.

tyro makes the parser from the options' dataclass. Here its help loses what only programmers need,
and its boxes of complaints become one line.
"""

import io
import re
from collections.abc import Sequence
from contextlib import redirect_stderr
from dataclasses import replace
from types import NoneType
from typing import Any, TypeVar, get_args

from pica_command.errors import UsageError

T = TypeVar("T")

GONE = ("coalesce_above_busy", "coalesce_longest_s")
"""Options of former releases that have no successor: frames do not wait for others any more."""

_SECTION = re.compile(r"^(Args|Returns|Raises|Attributes|Not checked|Source):", re.MULTILINE)


def description_of(docstring: str) -> str:
    """What of a function's docstring is meant for people who type its command."""
    return _SECTION.split(docstring, maxsplit=1)[0].strip().replace("``", "`")


def parse_words(options_type: type[T], words: Sequence[str], *, prog: str, description: str) -> T:
    """Read the words of a command.

    Raises:
        UsageError: They are not what the command takes; one line.
        SystemExit: Help was asked for, and printed.
    """
    import tyro  # half of a command's start; --version and the list do without

    said = io.StringIO()
    try:
        with redirect_stderr(said):
            return tyro.cli(
                options_type,
                prog=prog,
                args=list(words),
                description=description,
                registry=_registry(),
            )
    except SystemExit as end:
        if end.code != 2:
            raise
        raise UsageError(one_line(said.getvalue())) from None


def one_line(box: str) -> str:
    """Return what the parser of the command line says in a box of many lines."""
    _title, *lines = [line.strip("│╭╮╰╯ ") for line in box.splitlines()] or [""]
    # Rules, of dashes where the terminal knows no better, stand between the parts.
    parts = re.split(r"(?:[─-]{3,}\s*)+", " ".join(line for line in lines if line))
    text = next((part.strip(" .") for part in parts if part.strip()), "bad usage")
    near = re.search(r"Perhaps you meant:\s+(--[a-z0-9.-]+)", " ".join(lines))
    if any(name in text.replace("-", "_") for name in GONE):
        return f"{text}; this setting has gone, leave it out"
    return text + (f"; did you mean {near[1]}?" if near else "; `--help` lists all options")


def _registry() -> Any:
    """Rules that let help say ``PATH`` where a value may also be absent, not ``{None}|PATH``."""
    from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

    registry = ConstructorRegistry()

    @registry.primitive_rule
    def optional(info: PrimitiveTypeInfo) -> Any:
        kinds = [kind for kind in get_args(info.type) if kind is not NoneType]
        if len(kinds) != 1 or NoneType not in get_args(info.type):
            return None
        inner = ConstructorRegistry.get_primitive_spec(
            PrimitiveTypeInfo.make(kinds[0], info.markers)
        )
        if not isinstance(inner, PrimitiveConstructorSpec) or inner.nargs != 1:
            return None
        return replace(
            inner,
            instance_from_str=lambda words: (
                None if words in (["None"], ["unset"]) else inner.instance_from_str(words)
            ),
            is_instance=lambda value: value is None or inner.is_instance(value),
            str_from_instance=lambda value: (
                ["unset"] if value is None else inner.str_from_instance(value)
            ),
        )

    return registry
