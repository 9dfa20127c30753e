"""Write the second half of docs/command-line.md: every command with its options.

python scripts/command_page.py

What is said of an option is the text under its field in the code; a test compares the page with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from cyclopts import Argument

from pica_command.options import COMMON, CommandLine
from pica_command.table import COMMANDS, GROUPS

PAGE = Path(__file__).resolve().parent.parent / "docs" / "command-line.md"

MARK = "<!-- from here on written by scripts/command_page.py -->"
MEASUREMENTS = "Measurements"
"""The group whose options `--help` alone explains."""


def page() -> str:
    """Return the page: its head as it is, and the options as the code has them."""
    lines = [PAGE.read_text().partition(MARK)[0] + MARK, ""]
    for heading, rows in GROUPS.items():
        lines += [f"## {heading}", ""]
        for name, row in rows.items():
            lines += [f"### `pica {name}`", "", f"{row.summary()}.", ""]
            if heading == MEASUREMENTS:
                continue
            if options := list(_options(name)):
                lines += ["| option | default | what |", "|---|---|---|", *options, ""]
    return "\n".join(lines)


def _options(name: str) -> Iterator[str]:
    arguments = CommandLine(name, COMMANDS[name], {}, None).app.assemble_argument_collection(
        parse_docstring=True
    )
    for argument in arguments:
        if argument.show and argument.name.removeprefix("--") not in COMMON:
            text = " ".join((argument.parameter.help or "").split()).replace("|", "\\|")
            yield f"| `{argument.name}` | {_default(argument)} | {text} |"


def _default(argument: Argument) -> str:
    value = argument.field_info.default
    if argument.required:
        return "required"
    show = argument.parameter.show_default
    if value is argument.field_info.empty or value in (None, "", ()):
        return ""
    if callable(show):
        return f"`{show(value)}`"
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


if __name__ == "__main__":
    PAGE.write_text(page())
    print(f"wrote {PAGE.name}")
