"""Run the commands of pages, as a reader would type them, in a new folder; write one page.

    python scripts/pages.py README.md docs/quick-start.md
    python scripts/pages.py docs/tutorial.md          # trains very little; a minute
    python scripts/pages.py docs/own-head.md          # three drafts; five minutes
    python scripts/pages.py --command-line            # write the options of docs/command-line.md

Every ``sh`` block of a page is run in order, and a command that fails ends the run. A comment in
front of a block changes that:

    <!-- in the background -->       it runs until the next heading, and is then stopped by Ctrl-C
    <!-- only read: REASON -->       its ``pica`` commands are only checked for options that exist

What is another machine's or a person's is replaced, see `HERE`. A rig, a scan, photos and a film
lie ready where a page names them, and the folder is the user's home.
On the page of the command line an option is described by the first sentence under its field in the
code; `--help` shows the rest, and a test compares the page with the code.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from cyclopts import Argument

from pica_command.options import COMMON, CommandLine
from pica_command.table import COMMANDS, GROUPS, command_of, refuse

ROOT = Path(__file__).resolve().parent.parent
HERE = {
    "wss://relay.example": "ws://127.0.0.1:8765",
    "192.168.1.20": "127.0.0.1",
    "webcam setup": "webcam setup --from face_landmarker.task",
    " --draft": " --draft --yes",
}
"""What a page says, and what is done instead: nothing is fetched, no person asked."""
LONGEST_S = 3600
COMMAND_LINE = ROOT / "docs" / "command-line.md"
MARK = "<!-- from here on written by scripts/pages.py --command-line -->"
COLUMNS = 118
MEASUREMENTS = "Measurements"
"""The group whose options `--help` alone explains."""
BLOCK = re.compile(r"(?:<!-- ([^\n]*?) -->\n+)?```sh\n(.*?)```|^(#+) [^\n]*$", re.M | re.S)


@dataclass(frozen=True)
class Block:
    """Some lines of a page, and how they are to be run; a heading has none."""

    how: str
    text: str

    @property
    def commands(self) -> list[list[str]]:
        """The words of its `pica` commands."""
        lines = self.text.replace("\\\n", " ").splitlines()
        split = (shlex.split(line.partition(" > ")[0], comments=True) for line in lines)
        return [words[1:] for words in split if words[:1] == ["pica"]]


def blocks_of(page: str) -> Iterator[Block]:
    """The blocks and headings of a page."""
    for how, text, heading in BLOCK.findall(page):
        if heading:
            yield Block("heading", "")
        elif how == "" or how == "in the background" or how.startswith("only read: "):
            yield Block(how, text)
        else:
            raise ValueError(f"a block is marked {how!r}, which says nothing about how to run it")


def check(words: list[str]) -> None:
    """Read the words of a command, which is not run.

    Raises:
        UsageError: There is no such command, or it has no such options.
    """
    name = command_of(words)
    if name is None:
        refuse(words)
    CommandLine(name, COMMANDS[name], None).read(words[len(name.split()) :])


def environment(folder: Path) -> dict[str, str]:
    """Our `pica` first, no display, and nothing that the user has set or keeps for it."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PICA_")}
    for name in ("DISPLAY", "XDG_DATA_HOME"):
        kept.pop(name, None)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return kept | {"PATH": path, "PICA_CONFIG": os.devnull, "HOME": str(folder)}


def run_page(path: Path, page: str, folder: Path) -> None:
    """Run one page of this text in a folder."""
    running: list[subprocess.Popen[bytes]] = []
    try:
        for block in blocks_of(page):
            text = block.text
            if block.how == "heading":
                stop(running)
            elif block.how.startswith("only read"):
                for words in block.commands:
                    check(words)
            elif block.how:
                print(f"{path.name} &\n{text}", flush=True)
                running.append(start(f"exec {text}", folder))
                time.sleep(3)
            else:
                print(f"{path.name} $\n{text}", flush=True)
                if code := start(f"set -e\n{text}", folder).wait(LONGEST_S):
                    sys.exit(f"{path.name}: that ended with {code}")
    finally:
        stop(running)


def start(text: str, folder: Path) -> subprocess.Popen[bytes]:
    """Run some lines in a shell."""
    return subprocess.Popen(["bash", "-c", text], cwd=folder, env=environment(folder))


def stop(running: list[subprocess.Popen[bytes]]) -> None:
    """Press Ctrl-C in all of them; each must end well."""
    while running:
        process = running.pop()
        process.send_signal(signal.SIGINT)
        if code := process.wait(60):
            sys.exit(f"what ran in the background ended with {code}")


def command_line_page() -> str:
    """Return the page: its head as it is, and the options as the code has them."""
    lines = [COMMAND_LINE.read_text().partition(MARK)[0] + MARK, ""]
    shown: set[str] = set()
    for heading, rows in GROUPS.items():
        lines += [f"## {heading}", ""]
        for name, row in rows.items():
            lines += [f"### `pica {name}`", "", f"{row.summary()}.", ""]
            if heading != MEASUREMENTS and (options := list(_options(name))):
                again = [line.split()[1].strip("`") for line in options if line in shown]
                lines += [line for line in options if line not in shown]
                if again:
                    also = "- As above: " + ", ".join(f"`{option}`" for option in again)
                    lines.append(textwrap.fill(also, COLUMNS, subsequent_indent="  "))
                lines.append("")
                shown.update(options)
    return "\n".join(lines)


def _options(name: str) -> Iterator[str]:
    """Yield a line for each option that is in no group: its name, its default and the first
    sentence of its help."""
    arguments = CommandLine(name, COMMANDS[name], None).app.assemble_argument_collection(
        parse_docstring=True
    )
    for argument in arguments:
        name = argument.name.removeprefix("--")
        if argument.show and name not in COMMON and not set(".*") & set(name):
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


def main() -> None:
    """Run the pages that are named, or write the one that is generated."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path)
    parser.add_argument("--command-line", action="store_true", help="write docs/command-line.md")
    options = parser.parse_args()
    if options.command_line:
        COMMAND_LINE.write_text(command_line_page())
    sys.path.insert(0, str(ROOT / "tests"))
    from helpers.face_networks import face_file
    from helpers.own_head import AZIMUTHS, draw_person_from, write_film, write_photos, write_scan
    from helpers.rig_toy import toy_rig, write_glb

    lying: dict[str, Callable[[Path], object]] = {
        "head.glb": lambda path: write_glb(path, toy_rig()),
        "scan.glb": write_scan,
        "photos": write_photos,
        "film.mp4": lambda path: write_film(path, draw_person_from(*AZIMUTHS), 6.0),
        "face_landmarker.task": lambda path: shutil.copy(face_file(), path),
    }
    for page in options.pages:
        with tempfile.TemporaryDirectory(prefix="pica-page-") as folder:
            text = page.read_text(encoding="utf-8")
            for there, here in HERE.items():
                text = text.replace(there, here)
            named = {w for block in blocks_of(text) for words in block.commands for w in words}
            for name in named & lying.keys():
                lying[name](Path(folder) / name)
            run_page(page, text, Path(folder))


if __name__ == "__main__":
    main()
