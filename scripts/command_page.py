"""Write the second half of docs/command-line.md: every command with its options.

python scripts/command_page.py

An option is described by the first sentence under its field in the code; `--help` shows the rest. A
test compares the page with the code.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator
from pathlib import Path

from cyclopts import Argument

from pica_command.options import COMMON, CommandLine
from pica_command.table import COMMANDS, GROUPS

PAGE = Path(__file__).resolve().parent.parent / "docs" / "command-line.md"

MARK = "<!-- from here on written by scripts/command_page.py -->"
COLUMNS = 118
MEASUREMENTS = "Measurements"
"""The group whose options `--help` alone explains."""


def page() -> str:
    """Return the page: its head as it is, and the options as the code has them."""
    lines = [PAGE.read_text().partition(MARK)[0] + MARK, ""]
    for heading, rows in GROUPS.items():
        lines += [f"## {heading}", ""]
        for name, row in rows.items():
            lines += [f"### `pica {name}`", "", f"{row.summary()}.", ""]
            if heading != MEASUREMENTS and (options := list(_options(name))):
                lines += [*options, ""]
    return "\n".join(lines)


def _options(name: str) -> Iterator[str]:
    """Yield a line for each option: its name, its default and the first sentence of its help."""
    arguments = CommandLine(name, COMMANDS[name], {}, None).app.assemble_argument_collection(
        parse_docstring=True
    )
    for argument in arguments:
        if argument.show and argument.name.removeprefix("--") not in COMMON:
            text = " ".join((argument.parameter.help or "").split())
            first = re.split(r"(?<=[^.])\. |; |: |\.$", text)[0]
            line = f"- `{argument.name}{_default(argument)}` {first}"
            yield textwrap.fill(line, COLUMNS, subsequent_indent="  ", break_on_hyphens=False)


def _default(argument: Argument) -> str:
    """Return a default as it is written after an option; empty if there is none."""
    value = argument.field_info.default
    show = argument.parameter.show_default
    if argument.required or value is argument.field_info.empty or value in (None, "", (), False):
        return ""
    if callable(show):
        return f" {show(value)}"
    return f" {str(value).lower() if value is True else value}"


if __name__ == "__main__":
    PAGE.write_text(page())
    print(f"wrote {PAGE.name}")
