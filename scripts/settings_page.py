"""Write docs/settings.md: every setting of a relay and of those who join, and what it does.

python scripts/settings_page.py

What is said of a setting is the text under its field in the code; a test compares the page with it.
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

from pica_client.cli.send import SendOptions
from pica_client.cli.view import ViewOptions
from pica_command.profile import SHARED
from pica_command.settings import Setting, settings_of
from pica_server.cli.relay import RelayOptions

PAGE = Path(__file__).resolve().parent.parent / "docs" / "settings.md"

HEAD = """# Settings

Written by `python scripts/settings_page.py` from the code.

Every option of every command can be set in four places. An earlier one goes before a later one:

1. a flag: `pica send --fps 25`
2. a variable: `PICA_<COMMAND>_<OPTION>`, as `PICA_SEND_FPS=25` or `PICA_BENCH_CALL_PEERS=3`
3. a file: your profile, or for a relay the file that `--config` names
4. the default

`pica COMMAND --print-config` prints every option with its value and where that comes from, and
does nothing else. What it prints can be put into the file. Passwords in addresses are not shown.
An unknown key or variable, a value of a wrong type or out of range ends in one line and exit
status 2. An empty variable is not set.

## Your profile

What you would type every time, say once:

```sh
pica config set url wss://relay.example:8765
pica config set room standup
pica config set name Ada
pica config set token-file ~/ada.token
pica config set send.fps 25
pica config show
pica config unset send.fps
```

These options are shared by all commands that meet others in a room (`pica send`, `pica view`,
`pica avatar push`), and have a variable without a command, too:

SHARED
The profile is a TOML file that only you can read; `pica config path` prints where it is. Shared
options stand at the top, those of one command in its table, as `fps = 25.0` under `[send]`. Keep
tokens and secrets in files of their own and name the files: the profile never holds them. File
names in it are relative to it. `PICA_PROFILE` names another profile; `PICA_PROFILE=none` uses
none. A relay and the processes of `pica demo` read no profile.
"""

RELAY_HEAD = """## A relay

One setting is `--limits.joins-per-s 5`, `PICA_RELAY_LIMITS_JOINS_PER_S=5`, and `joins_per_s = 5`
under `[limits]` in the file that `--config FILE` or `PICA_RELAY_CONFIG` names; see
[operating.md](operating.md#settings).
"""

TITLES = {
    "limits": "Limits of a relay: `[limits]`",
    "store": "Avatar store of a relay: `[store]`",
}
CLIENTS = {"send": SendOptions, "view": ViewOptions}


def page() -> str:
    """Return the page."""
    lines = [HEAD.replace("SHARED", shared_table())]
    for command, options_type in CLIENTS.items():
        lines += [
            f"## `pica {command}`",
            "",
            *_table(settings_of(options_type), options_type()),
            "",
        ]
    settings = settings_of(RelayOptions)
    for table, title in {"": "", **TITLES}.items():
        lines += [f"## {title}", ""] if table else [RELAY_HEAD]
        chosen = [one for one in settings if one.name.rpartition(".")[0] == table]
        lines += [*_table(chosen, RelayOptions()), ""]
    return "\n".join(lines)


def shared_table() -> str:
    """Return the table of options that several commands share."""
    rows = [f"| `{name}` | `PICA_{name.upper()}` |" for name in SHARED]
    return "\n".join(["| key | variable |", "|---|---|", *rows, ""])


def _table(settings: list[Setting], options: Any) -> list[str]:
    rows = [
        f"| `{one.flag}` | {_default(one, options)} | {_text(one, options)} |" for one in settings
    ]
    return ["| flag | default | what |", "|---|---|---|", *rows]


def _default(setting: Setting, options: Any) -> str:
    value = setting.value_in(options)
    if value is None or value in ("", ()):
        return ""
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


def _text(setting: Setting, options: Any) -> str:
    owner: Any = options
    for attribute in setting.path[:-1]:
        owner = getattr(owner, attribute)
    texts = dict(_texts_under_fields(type(owner)))
    return " ".join(texts.get(setting.path[-1], "").split()).replace("|", "\\|")


def _texts_under_fields(cls: type) -> Iterator[tuple[str, str]]:
    """Give name and text of each field of a dataclass: no object of it holds the text."""
    body = ast.parse(inspect.getsource(cls)).body[0]
    assert isinstance(body, ast.ClassDef)
    names = {field.name for field in fields(cls)}
    for field, text in zip(body.body, body.body[1:], strict=False):
        is_field = isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if (
            not is_field
            or not isinstance(text, ast.Expr)
            or not isinstance(text.value, ast.Constant)
        ):
            continue
        name = field.target.id  # type: ignore[attr-defined]
        if name in names:
            yield name, str(text.value.value)


if __name__ == "__main__":
    PAGE.write_text(page())
    print(f"wrote {PAGE.name}")
