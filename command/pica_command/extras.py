"""The optional parts of this package, and the line that installs one.

Nothing is published on a package index, so the line begins where this installation came from: a
checkout, a git repository or a wheel, as pip notes in ``direct_url.json`` (PEP 610).
"""

import json
import re
import shlex
from collections.abc import Iterable, Mapping
from importlib.metadata import distribution, requires
from typing import Any, Final
from urllib.parse import unquote, urlsplit
from urllib.request import url2pathname

from pica_command.table import DISTRIBUTION

_MODULES: Final = {
    "pillow": "PIL",
    "nats-py": "nats",
    "prometheus-client": "prometheus_client",
    "pyjwt": "jwt",
    "imgui-bundle": "imgui_bundle",
    "python-bidi": "bidi",
    "python-osc": "pythonosc",
}
"""Where the name to import differs from the name to install, by more than a dash."""


def modules_by_extra() -> dict[str, tuple[str, ...]]:
    """Each extra with the top-level modules that it brings, those of extras in it included."""
    direct: dict[str, list[str]] = {}
    inside: dict[str, list[str]] = {}
    for line in requires(DISTRIBUTION) or ():
        requirement, _, marker = line.partition(";")
        found = re.search(r"extra == ['\"]([^'\"]+)", marker)
        if found is None:
            continue
        name, extras = re.match(r"([A-Za-z0-9._-]+)(?:\[([^\]]*)\])?", requirement).groups()  # type: ignore[union-attr]
        if name == DISTRIBUTION:
            inside.setdefault(found[1], []).extend(extras.split(","))
        else:
            module = _MODULES.get(name.lower(), name.replace("-", "_"))
            direct.setdefault(found[1], []).append(module)

    def modules(extra: str) -> Iterable[str]:
        yield from direct.get(extra, ())
        for other in inside.get(extra, ()):
            yield from modules(other.strip())

    names = distribution(DISTRIBUTION).metadata.get_all("Provides-Extra") or []
    return {name: tuple(dict.fromkeys(modules(name))) for name in names}


def extra_with(module: str, preferred: Iterable[str] = ()) -> str | None:
    """The extra to install for a module that is missing.

    Args:
        module: What could not be imported; its top level counts.
        preferred: Extras that the command needs anyway; the first that brings the module is named.

    Returns:
        The name, or the smallest extra that brings the module, or None: it is none of ours.
    """
    top = module.partition(".")[0]
    by_extra = modules_by_extra()
    bringing = [extra for extra, modules in by_extra.items() if top in modules]
    for extra in preferred:
        if extra in bringing:
            return extra
    return min(bringing, key=lambda extra: (len(by_extra[extra]), extra), default=None)


def install_line(extra: str) -> str:
    """The command that installs an extra from where this installation came from."""
    text = distribution(DISTRIBUTION).read_text("direct_url.json")
    return "pip install " + (_from_origin(json.loads(text), extra) if text else f"'.[{extra}]'")


def _from_origin(origin: Mapping[str, Any], extra: str) -> str:
    url = origin["url"]
    if "vcs_info" in origin:
        address = f"{origin['vcs_info']['vcs']}+{url}"
        return shlex.quote(f"{DISTRIBUTION}[{extra}] @ {address}")
    if urlsplit(url).scheme == "file":
        target = shlex.quote(f"{url2pathname(unquote(urlsplit(url).path))}[{extra}]")
        return f"--editable {target}" if origin.get("dir_info", {}).get("editable") else target
    return shlex.quote(f"{DISTRIBUTION}[{extra}] @ {url}")
