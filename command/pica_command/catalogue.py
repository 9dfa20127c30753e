"""Which commands there are, what each does in a line, and which one a mistyped word meant.

The line is read from the source of the command's function, which is not imported: the list is there
on an installation that lacks what some commands need.
"""

import ast
import difflib
import importlib.util
import inspect
import re
import typing
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points, metadata
from pathlib import Path
from typing import Final

from pica_command.extras import DISTRIBUTION
from pica_command.parsing import description_of

COMMAND_GROUP: Final = "pica.commands"

GROUPS: Final = {
    "Calls": ("demo", "view", "send", "track", "calibrate", "webcam", "secret"),
    "A relay": ("relay", "token", "room"),
    "Avatars": ("avatar", "capture", "train", "export", "eval"),
    "This machine": ("doctor", "config", "completion"),
    "Measurements": ("bench",),
}
"""Headings of the list, by the first words of commands; what an extension adds stands last."""
OTHERS: Final = "Others"


def commands() -> dict[str, EntryPoint]:
    """Every command by its name, in which dots stand for spaces."""
    return {entry.name: entry for entry in entry_points(group=COMMAND_GROUP)}


def spoken(name: str) -> str:
    """A command as people type it."""
    return f"pica {name.replace('.', ' ')}"


def options_type_of(entry: EntryPoint) -> type:
    """The dataclass of a command's options; this loads the command."""
    function = entry.load()
    (parameter,) = inspect.signature(function).parameters
    options_type: type = typing.get_type_hints(function)[parameter]
    return options_type


def summary(entry: EntryPoint) -> str:
    """What a command does, up to the first full stop, colon or semicolon; empty if unsaid."""
    spec = importlib.util.find_spec(entry.module)
    if spec is None or spec.origin is None:
        return ""
    for node in ast.parse(Path(spec.origin).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name == entry.attr:
            text = " ".join(description_of(ast.get_docstring(node) or "").split())
            return re.split(r"[.:;] ", text)[0].removesuffix(".")
    return ""


def listing(known: Mapping[str, EntryPoint], family: str = "") -> str:
    """The list of all commands, or of those whose first word is `family`."""
    grouped: dict[str, list[str]] = {heading: [] for heading in (*GROUPS, OTHERS)}
    for name in known:
        first = name.partition(".")[0]
        if family in ("", first):
            heading = next((head for head, words in GROUPS.items() if first in words), OTHERS)
            grouped[heading].append(name)
    lines = [
        metadata(DISTRIBUTION)["Summary"],
        "",
        f"usage: {' '.join(filter(None, ('pica', family)))} COMMAND [OPTIONS] [--json]",
    ]
    width = max(len(name) for names in grouped.values() for name in names) + 2
    for heading, names in grouped.items():
        if names:
            order = GROUPS.get(heading, ())
            names.sort(key=lambda name: _place(name, order))
            rows = (f"  {name.replace('.', ' '):{width}}{summary(known[name])}" for name in names)
            lines += ["", f"{heading}:", *(row.rstrip() for row in rows)]
    return "\n".join([*lines, "", "`pica COMMAND --help` explains one of them."])


def _place(name: str, order: tuple[str, ...]) -> tuple[int, str]:
    first = name.partition(".")[0]
    return (order.index(first) if first in order else len(order), name)


def nearest(words: list[str], known: Mapping[str, EntryPoint]) -> str | None:
    """The command that these first words probably meant; None if nothing is like them."""
    names = {name.replace(".", " ") for name in known}
    names |= {name.partition(" ")[0] for name in names}
    for count in (2, 1):
        found = difflib.get_close_matches(" ".join(words[:count]), names, n=1, cutoff=0.7)
        if found:
            return found[0]
    return None
