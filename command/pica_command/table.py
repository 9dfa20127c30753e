"""Every command of `pica`: the function that runs it, and the extras it needs.

Two words are a command of a family, as in ``pica bench call``. Nothing named here is imported until
its command is called, so that the relay starts without numpy.

Nothing is published on a package index, so the line that installs an extra names where this
installation came from: a checkout, a git repository or a wheel, as pip notes in ``direct_url.json``
(PEP 610).
"""

import ast
import difflib
import importlib
import importlib.util
import json
import re
import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import distribution, requires
from pathlib import Path
from typing import Any, Final, NoReturn

DISTRIBUTION: Final = "pica-telepresence"
"""The name under which this package is installed."""
_MODULES: Final = {
    "dracopy": "DracoPy",
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


@dataclass(frozen=True, slots=True)
class Command:
    """One row of the table."""

    target: str
    """Module and function. The parameters of the function are frozen dataclasses, whose fields are
    the options; it returns a mapping or None."""
    extras: tuple[str, ...] = ()
    """Optional parts of the package that it needs."""
    joins: bool = False
    """It joins a room, so that variables and keys of `SHARED` set its options, too."""

    def load(self) -> Any:
        """Import the function."""
        module, _, name = self.target.partition(":")
        return getattr(importlib.import_module(module), name)

    def summary(self) -> str:
        """What it does: its docstring up to the first full stop, colon or semicolon.

        It is read from the source, which is not imported: the list of commands is complete on an
        installation that lacks what some of them need.
        """
        module, _, name = self.target.partition(":")
        spec = importlib.util.find_spec(module)
        assert spec is not None
        assert spec.origin is not None
        for node in ast.parse(Path(spec.origin).read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name == name:
                text = " ".join((ast.get_docstring(node) or "").split())
                return re.split(r"[.:;](?: |$)", text)[0]
        return ""


SHARED: Final = ("url", "room", "name", "token_file", "secret_file")
"""Options that the commands which join a room may have in common."""

GROUPS: Final[dict[str, dict[str, Command]]] = {
    "Calls": {
        "demo": Command("pica_client.cli.demo:demo", ("view", "video")),
        "view": Command("pica_client.cli.view:view", ("view",), joins=True),
        "send": Command("pica_client.cli.send:send", ("send",), joins=True),
        "agent": Command("pica_client.cli.send:agent", ("send",), joins=True),
        "track": Command("pica_client.cli.track:track", ("send",)),
        "calibrate": Command("pica_client.cli.track:calibrate", ("send",)),
        "webcam setup": Command("pica_client.cli.machine:webcam_setup", ("webcam",)),
        "secret": Command("pica_client.cli.machine:secret"),
    },
    "A relay": {
        "relay": Command("pica_server.cli.relay:relay"),
        "token": Command("pica_server.cli.token:token"),
    },
    "Avatars": {
        "avatar info": Command("pica_core.cli:avatar_info", ("send",)),
        "avatar make": Command("pica_core.train.cli.make:avatar_make", ("train", "me")),
        "capture check": Command("pica_core.cli:check", ("capture",)),
        "capture expressions": Command("pica_core.cli:expressions", ("me",)),
        "capture me": Command("pica_core.cli:me", ("me",)),
        "capture person": Command("pica_core.cli:person", ("capture",)),
        "capture rig": Command("pica_core.cli:rig", ("capture",)),
        "train": Command("pica_core.train.cli.train:train", ("train",)),
        "export": Command("pica_core.train.cli.train:export", ("train",)),
        "eval": Command("pica_core.train.cli.eval:eval_runs", ("train",)),
    },
    "This machine": {"doctor": Command("pica_client.cli.machine:doctor")},
    "Measurements": {
        "bench call": Command("pica_client.bench.call:bench_call", ("bench",)),
        "bench claim": Command("pica_core.train.cli.train:bench_claim", ("train",)),
        "bench decode": Command("pica_client.cli.bench:bench_decode", ("bench",)),
        "bench drive": Command("pica_client.cli.bench:bench_drive", ("bench",)),
        "bench relay": Command("pica_client.bench.relay.bench:bench_relay"),
        "bench scene": Command("pica_client.cli.bench:bench_scene", ("bench",)),
        "bench voice": Command("pica_client.cli.bench:bench_voice", ("bench",)),
    },
}
COMMANDS: Final = {name: row for rows in GROUPS.values() for name, row in rows.items()}


def command_of(words: list[str]) -> str | None:
    """The longest command that the first words spell."""
    return next((name for n in (2, 1) if (name := " ".join(words[:n])) in COMMANDS), None)


class UsageError(Exception):
    """Words, variables or keys that no command understands: one line."""

    exit_code = 2


def listing(family: str = "") -> str:
    """The list of all commands, or of those whose first word is `family`."""
    width = max(map(len, COMMANDS)) + 2
    lines = [f"Usage: pica {f'{family} ' if family else ''}COMMAND [OPTIONS]"]
    for heading, rows in GROUPS.items():
        chosen = [name for name in rows if family in ("", name.partition(" ")[0])]
        if chosen:
            lines += ["", f"{heading}:"]
            lines += [f"  {name:{width}}{rows[name].summary()}" for name in chosen]
    return "\n".join(lines)


def refuse(words: list[str]) -> NoReturn:
    """Refuse words that begin no command.

    Raises:
        UsageError: Names the command that was probably meant.
    """
    family = any(name.startswith(f"{words[0]} ") for name in COMMANDS)
    known = {*COMMANDS, *(name.partition(" ")[0] for name in COMMANDS)}
    near = (difflib.get_close_matches(" ".join(words[:n]), known, n=1, cutoff=0.7) for n in (2, 1))
    found = next((names[0] for names in near if names), None)
    hint = f"did you mean `pica {found}`?" if found else "`pica --help` lists all commands"
    raise UsageError(f"no command {' '.join(words[: 1 + family])!r}; {hint}")


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
