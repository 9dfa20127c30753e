"""The optional parts of this package, and the line that installs one.

Nothing is published on a package index, so the line names where this installation came from: a
checkout, a git repository or a wheel, as pip notes in ``direct_url.json`` (PEP 610).
"""

import json
import re
import shlex
from collections.abc import Iterable
from importlib.metadata import distribution, requires
from typing import Any, Final

from pica_command.table import DISTRIBUTION

_MODULES: Final = {
    "pillow": "PIL",
    "nats-py": "nats",
    "imgui-bundle": "imgui_bundle",
    "python-bidi": "bidi",
    "python-osc": "pythonosc",
}
"""Where the name to import differs from the name to install, by more than a dash."""
_REQUIREMENT: Final = re.compile(
    r"([\w.-]+)(?:\[([^]]*)\])?[^;]*;.*extra == ['\"]([\w-]+)"  # name, extras of it, extra
)


def modules_by_extra() -> dict[str, tuple[str, ...]]:
    """Each extra with the top-level modules that it brings, those of extras in it included."""
    lines = (_REQUIREMENT.match(line) for line in requires(DISTRIBUTION) or ())
    rows = [line.groups() for line in lines if line is not None]

    def modules(extra: str) -> Iterable[str]:
        for name, inside, owner in rows:
            if owner == extra and name == DISTRIBUTION:
                for other in inside.split(","):
                    yield from modules(other.strip())
            elif owner == extra:
                yield _MODULES.get(name.lower(), name.replace("-", "_"))

    return {extra: tuple(dict.fromkeys(modules(extra))) for _, _, extra in rows}


def extra_with(module: str, preferred: Iterable[str] = ()) -> str | None:
    """The extra to install for a module that is missing.

    Args:
        module: What could not be imported; its top level counts.
        preferred: Extras that the command needs anyway; the first that brings the module is named.

    Returns:
        The name, or the smallest extra that brings the module, or None: it is none of ours.
    """
    top = module.partition(".")[0]
    sizes = {extra: len(brings) for extra, brings in modules_by_extra().items() if top in brings}
    wanted = [extra for extra in preferred if extra in sizes]
    return (
        wanted[0] if wanted else min(sizes, key=lambda extra: (sizes[extra], extra), default=None)
    )


def install_line(extra: str) -> str:
    """The command that installs an extra from where this installation came from."""
    origin: dict[str, Any] = json.loads(
        distribution(DISTRIBUTION).read_text("direct_url.json") or '{"url": "."}'
    )
    url = origin["url"]
    if origin.get("dir_info", {}).get("editable") or url == ".":
        return f"pip install --editable {shlex.quote(f'{url}[{extra}]')}"
    if "vcs_info" in origin:
        url = f"{origin['vcs_info']['vcs']}+{url}"
    return f"pip install {shlex.quote(f'{DISTRIBUTION}[{extra}] @ {url}')}"
