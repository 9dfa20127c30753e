"""How large the code is: the lines of each room beside its budget, sizes of files, import circles.

    python scripts/house.py [--json]

production_lines    lines of Python in the five packages
files               Python files of the packages
scripts_lines       lines of Python in scripts/
test_lines          lines of Python in tests/
docs_words          words of all Markdown files
largest_folder      source files in the fullest folder of the packages, ``__init__.py`` included
longest_file        lines of the longest Python file, of tests and scripts, too
circle              modules that import each other in a loop, however far around
dialect             lines with words that the field does not use; ``--words`` prints them

Imports under ``if TYPE_CHECKING`` and inside functions count for circles: a loop that is only
broken by being late is still a loop.
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("command", "protocol", "server", "pica_core", "client")
"""Folders at the root; each holds one package."""
CORE, CLIENT, SERVER = "pica_core/pica_core/", "client/pica_client/", "server/pica_server/"
ROOMS: dict[str, tuple[int, tuple[str, ...]]] = {
    "command": (350, ("command/",)),
    "protocol": (1300, ("protocol/",)),
    "server/placement": (450, (SERVER + "placement/",)),
    "server/room": (1100, (SERVER + "room/",)),
    "server/net": (500, (SERVER + "net/",)),
    "server/store": (500, (SERVER + "store/",)),
    "server, rest": (1750, (SERVER,)),
    "core/codec": (450, (CORE + "codec/",)),
    "core/avatar, graphs, model, reference": (
        3900,
        (CORE + "avatar/", CORE + "graphs", CORE + "model/", CORE + "reference"),
    ),
    "core/train": (4400, (CORE + "train/",)),
    "core/capture and the rest": (7000, (CORE,)),
    "client/avatars": (650, (CLIENT + "avatars/",)),
    "client/bench": (3200, (CLIENT + "bench/",)),
    "client/call, publish": (1700, (CLIENT + "call/", CLIENT + "publish.py")),
    "client/cli": (900, (CLIENT + "cli/",)),
    "client/decode, schedule, render": (
        3500,
        (CLIENT + "decode/", CLIENT + "schedule/", CLIENT + "render/"),
    ),
    "client/e2ee": (900, (CLIENT + "e2ee/",)),
    "client/playout": (800, (CLIENT + "playout/",)),
    "client/sources": (2300, (CLIENT + "sources/",)),
    "client/transport, endpoint": (600, (CLIENT + "transport/", CLIENT + "endpoint.py")),
    "client/ui": (3800, (CLIENT + "ui/",)),
    "client/voice": (1900, (CLIENT + "voice/",)),
    "client, rest": (600, (CLIENT,)),
}
"""Lines allowed, and beginnings of the paths that count; the first room that fits takes a file."""
DIALECT = re.compile(
    r"\b([Nn]obody|[Ss]omebody|[Ww]hoever|anew|one's own|lookout|[Rr]ulings?|[Ss]ays? whether)\b"
    r"|not worth a word"
)
"""Words for which the field has others: participant, peer, user or operator for people, again for
anew, "Return True if" for "Say whether"."""
READ = (*PACKAGES, "scripts", "examples", "docs", "README.md", "CONTRIBUTING.md", "SECURITY.md")


def tracked(pattern: str) -> list[str]:
    """Return the files of the repository that match, new ones included, as paths from its root."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", pattern]
    names = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return [name for name in names.splitlines() if (ROOT / name).exists()]


def room_of(path: str) -> str:
    """Return the room that a file of the packages counts in."""
    return next(room for room, (_, parts) in ROOMS.items() if path.startswith(parts))


def module_of(path: str) -> str:
    """Return a file's dotted name."""
    return ".".join(path.removesuffix(".py").removesuffix("/__init__").split("/")[1:])


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what a module does, in blocks of any depth: expressions hold no imports."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.stmt, ast.excepthandler, ast.match_case)):
            yield child
            yield from statements(child)


def imports_of(tree: ast.Module, modules: Iterable[str]) -> Iterator[str]:
    """Yield those of some modules that a module imports anywhere in its text."""
    for node in statements(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                if name in modules:
                    yield name
                elif node.module in modules:
                    yield node.module


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Return modules that import each other in a circle, if there are any."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def dialect() -> list[str]:
    """Return the lines with private words, results left out, as ``path:number: line``."""
    paths = [path for pattern in ("*.py", "*.md") for path in tracked(pattern)]
    return [
        f"{path}:{number}: {line.strip()}"
        for path in paths
        if path.startswith(READ) and not path.startswith(("docs/results", "scripts/house.py"))
        for number, line in enumerate((ROOT / path).read_text().splitlines(), 1)
        if DIALECT.search(line)
    ]


def measure() -> dict[str, Any]:
    """Return all counts, the lines of each room, and the circles."""
    lines = {path: len((ROOT / path).read_text().splitlines()) for path in tracked("*.py")}
    production = [path for path in lines if path.startswith(tuple(f"{p}/" for p in PACKAGES))]
    trees = {module_of(path): ast.parse((ROOT / path).read_text()) for path in production}
    graph = {name: set(imports_of(tree, trees)) - {name} for name, tree in trees.items()}
    rooms = Counter[str]()
    for path in production:
        rooms[room_of(path)] += lines[path]
    return {
        "production_lines": rooms.total(),
        "files": len(production),
        "scripts_lines": sum(n for path, n in lines.items() if path.startswith("scripts/")),
        "test_lines": sum(n for path, n in lines.items() if path.startswith("tests/")),
        "docs_words": sum(len((ROOT / path).read_text().split()) for path in tracked("*.md")),
        "largest_folder": max(Counter(str(Path(path).parent) for path in production).values()),
        "longest_file": max(lines.values()),
        "dialect": len(dialect()),
        "rooms": {room: [rooms[room], budget] for room, (budget, _) in ROOMS.items()},
        "circle": circle(graph),
    }


def main() -> None:
    """Print the counts, as a table or as one JSON object."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--words", action="store_true", help="print private words; fail on any")
    if parser.parse_args().words:
        found = dialect()
        print("\n".join(found), end="\n" if found else "")
        sys.exit(bool(found))
    counts = measure()
    if parser.parse_args().json:
        print(json.dumps(counts))
        return
    rooms, loop = counts.pop("rooms"), counts.pop("circle")
    rooms["sum"] = [sum(each) for each in zip(*rooms.values(), strict=True)]
    print(f"{'room':40}{'lines':>8}{'budget':>8}{'over':>8}")
    for room, (num_lines, budget) in rooms.items():
        over = num_lines - budget
        print(f"{room:40}{num_lines:8}{budget:8}{over if over > 0 else '':>8}")
    print()
    for name, count in counts.items():
        print(f"{name:40}{count:8}")
    print("circle:", ", ".join(loop) or "none")


if __name__ == "__main__":
    main()
