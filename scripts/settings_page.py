"""Write docs/settings.md: every setting of a relay with its default and what it does.

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

from pica_server.cli.relay import RelayOptions
from pica_server.config.settings import Setting, settings_of

PAGE = Path(__file__).resolve().parent.parent / "docs" / "settings.md"

HEAD = """# Settings of a relay

Written by `python scripts/settings_page.py` from the code.
[operating.md](operating.md#settings) says how flags, environment and file go together: one setting
is `--limits.joins-per-s 5`, `PICA_RELAY_LIMITS_JOINS_PER_S=5`, and `joins_per_s = 5` under
`[limits]`. Besides these there are `--config FILE` (`PICA_RELAY_CONFIG`) and `--print-config`.
"""

TITLES = {
    "": "The relay",
    "limits": "Limits: `[limits]`",
    "webhook": "Webhooks: `[webhook]`",
    "store": "Avatar store: `[store]`",
}


def page() -> str:
    """Return the page."""
    lines = [HEAD]
    default = RelayOptions()
    settings = settings_of(RelayOptions)
    for table, title in TITLES.items():
        lines += [f"## {title}", "", "| flag | default | what |", "|---|---|---|"]
        lines += [
            f"| `{setting.flag}` | {_default(setting, default)} | {_text(setting, default)} |"
            for setting in settings
            if setting.name.rpartition(".")[0] == table
        ]
        lines.append("")
    return "\n".join(lines)


def _default(setting: Setting, options: RelayOptions) -> str:
    value = setting.value_in(options)
    if value is None or value in ("", ()):
        return ""
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


def _text(setting: Setting, options: RelayOptions) -> str:
    owner: Any = options
    for attribute in setting.path[:-1]:
        owner = getattr(owner, attribute)
    texts = dict(_texts_under_fields(type(owner)))
    return " ".join(texts[setting.path[-1]].split()).replace("``", "`").replace("|", "\\|")


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
