"""How the code is housed: sizes of folders and files, docstrings that say nothing, import circles.

    python scripts/house.py [--json] [--lists]

largest_folder      source files in the fullest folder of the packages, ``__init__.py`` included
production_lines    lines of Python in the packages; tests, scripts and examples apart
longest_file        lines of the longest file, of tests and scripts, too
import_circles      groups of modules that import each other in a loop, however far around
fragment_docstrings docstrings of one line that name no verb and no thing: those that begin with
                    Of, By, As, For, With, In, From, To, On or And, and those of one or two words

Imports under ``if TYPE_CHECKING`` and inside functions count for circles: a loop that is only
broken by being late is still a loop. What this does not see: whether a docstring is true.
"""

from __future__ import annotations

import argparse
import ast
import json
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = {
    "pica_command": "command",
    "pica_protocol": "protocol",
    "pica_server": "server",
    "pica_core": "pica_core",
    "pica_client": "client",
}
FRAGMENTS = {"of", "by", "as", "for", "with", "in", "from", "to", "on", "and"}
"""First words of a docstring that belong to a sentence whose beginning is missing."""


def tracked() -> list[Path]:
    """All Python files that belong to the repository, new ones included."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.py"]
    names = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return [ROOT / name for name in names.splitlines() if (ROOT / name).exists()]


def production(files: list[Path]) -> dict[str, Path]:
    """Files of the five packages by dotted name."""
    found = {}
    for path in files:
        parts = path.relative_to(ROOT).parts
        if len(parts) > 2 and PACKAGES.get(parts[1]) == parts[0]:
            name = ".".join(parts[1:]).removesuffix(".py").removesuffix(".__init__")
            found[name] = path
    return found


def imports_of(tree: ast.Module, modules: dict[str, Path]) -> Iterator[str]:
    """Modules of ours that a module imports anywhere in its text."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                if name in modules:
                    yield name
                elif node.module in modules:
                    yield node.module


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Strongly connected parts of more than one module (Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(graph[node]):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            group: list[str] = []
            while not group or group[-1] != node:
                group.append(stack.pop())
            if len(group) > 1:
                found.append(sorted(group))

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found


def fragments(path: Path, tree: ast.Module) -> Iterator[str]:
    """Places of docstrings that say nothing, the strings under fields and constants included."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for child in body if isinstance(body, list) else []:
            if not (isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)):
                continue
            text = child.value.value
            if isinstance(text, str) and "\n" not in text.strip():
                words = text.strip().split()
                if words and (words[0].lower() in FRAGMENTS or len(words) < 3):
                    yield f"{path.relative_to(ROOT)}:{child.lineno}: {text}"


def measure() -> dict[str, Any]:
    """All counts, and under ``lists`` what they count."""
    files = tracked()
    modules = production(files)
    trees = {name: ast.parse(path.read_text()) for name, path in modules.items()}
    folders = Counter(str(path.parent.relative_to(ROOT)) for path in modules.values())
    lines = {path: len(path.read_text().splitlines()) for path in files}
    graph = {name: set(imports_of(tree, modules)) - {name} for name, tree in trees.items()}
    loops = circles(graph)
    silent = [line for name, tree in trees.items() for line in fragments(modules[name], tree)]
    longest = max(lines, key=lambda path: lines[path])
    packages = Counter[str]()
    for name, path in modules.items():
        packages[name.split(".")[0]] += lines[path]
    return {
        "largest_folder": max(folders.values()),
        "production_lines": sum(packages.values()),
        "fragment_docstrings": len(silent),
        "import_circles": len(loops),
        "longest_file": lines[longest],
        "lists": {
            "folders": dict(folders.most_common()),
            "packages": dict(packages),
            "longest": str(longest.relative_to(ROOT)),
            "circles": loops,
            "fragments": silent,
        },
    }


def main() -> None:
    """Print the counts, as lines or as one JSON object."""
    parser = argparse.ArgumentParser(description="How the code is housed, in five numbers.")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    parser.add_argument("--lists", action="store_true", help="what was counted, too")
    options = parser.parse_args()
    counts = measure()
    lists = counts.pop("lists")
    if options.json:
        print(json.dumps(counts | ({"lists": lists} if options.lists else {})))
        return
    for name, count in counts.items():
        print(f"{name:20} {count}")
    if options.lists:
        print(json.dumps(lists, indent=2))


if __name__ == "__main__":
    main()
