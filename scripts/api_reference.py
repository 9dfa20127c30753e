"""A hook of mkdocs: one page of the API reference for each room, made from the docstrings.

A room is a package; its page has its own docstring, then those of its modules, and of their public
classes and functions. So a new module is on its page as soon as it is there.
"""

from __future__ import annotations

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
PACKAGES = (
    "protocol/pica_protocol",
    "server/pica_server",
    "pica_core/pica_core",
    "client/pica_client",
)
LEFT_OUT = {"cli"}
"""Rooms whose options `--help` shows."""


def rooms() -> dict[str, list[str]]:
    """The modules of each room, by the room's dotted name."""
    found: dict[str, list[str]] = {}
    for package in PACKAGES:
        folder = ROOT / package
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder.parent).with_suffix("").parts
            if LEFT_OUT & set(parts) or parts[-1] == "__main__":
                continue
            room = ".".join(parts[:-1])
            if parts[-1] == "__init__":
                found.setdefault(room, []).insert(0, room)
            else:
                found.setdefault(room, []).append(".".join(parts))
    return found


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages, and a list of them."""
    listing = ["# API reference", "", "Made from the docstrings, one page for each room.", ""]
    for room, modules in rooms().items():
        lines = [f"# {room}", ""]
        for module in modules:
            lines += [f"::: {module}", ""]
        files.append(File.generated(config, f"reference/{room}.md", content="\n".join(lines)))
        listing.append(f"- [{room}]({room}.md)")
    files.append(File.generated(config, "reference/index.md", content="\n".join(listing) + "\n"))
    return files
