"""``pica config``: what all commands of this user begin with."""

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from pica_command.catalogue import commands, options_type_of, spoken
from pica_command.errors import UsageError
from pica_command.profile import SHARED, profile_path, read_profile, write_profile
from pica_command.settings import Setting, hint, settings_of, value_of_text


@dataclass(frozen=True, kw_only=True, slots=True)
class ConfigOptions:
    """Options of `pica config show` and `pica config path`: none."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SetOptions:
    """Options of `pica config set`."""

    key: Positional[str]
    """url, room, name, token_file, ca_file or secret_file; or COMMAND.OPTION, such as send.fps."""
    value: Positional[str]
    """What it is set to. A list is written with commas; a switch is true or false."""


@dataclass(frozen=True, kw_only=True, slots=True)
class UnsetOptions:
    """Options of `pica config unset`."""

    key: Positional[str]
    """What to forget, as it was set."""


def config_path(options: ConfigOptions) -> dict[str, Any]:
    """Print where the profile is, or would be."""
    path = _path()
    print(path)
    return {"path": str(path), "exists": path.exists()}


def config_show(options: ConfigOptions) -> dict[str, Any]:
    """Print what the profile sets."""
    path = _path()
    document = read_profile(path)
    if not document:
        print(f"{path}: nothing is set; `pica config set KEY VALUE` does", file=sys.stderr)
    else:
        print(path.read_text(encoding="utf-8"), end="")
    return {"path": str(path), "profile": document}


def config_set(options: SetOptions) -> dict[str, Any]:
    """Set an option for all further commands of this user.

    Comments in the file are lost. Secrets and tokens stay in files of their own: the profile says
    where they are.
    """
    path = _path()
    command, setting = _find(options.key)
    value = value_of_text(setting, options.value, options.key)
    if setting.kind is Path:
        value = str(Path(value).expanduser().absolute())
    document = read_profile(path)
    table = document
    for word in (*command.split("."), *setting.name.split("."))[:-1] if command else ():
        table = table.setdefault(word, {})
    table[setting.name.rpartition(".")[2]] = value
    write_profile(path, document)
    return {"path": str(path), "key": options.key, "value": value}


def config_unset(options: UnsetOptions) -> dict[str, Any]:
    """Take an option out of the profile again."""
    path = _path()
    document = read_profile(path)
    *tables, key = options.key.replace("-", "_").split(".")
    table: Any = document
    for word in tables:
        table = table.get(word, {}) if isinstance(table, dict) else {}
    if not isinstance(table, dict) or key not in table:
        raise UsageError(f"{options.key} is not set in {path}; `pica config show` prints what is")
    del table[key]
    write_profile(path, document)
    return {"path": str(path), "key": options.key}


def _path() -> Path:
    path = profile_path(os.environ)
    if path is None:
        raise UsageError("PICA_PROFILE=none: no profile is used; unset the variable")
    return path


def _find(key: str) -> tuple[str, Setting]:
    """The command, empty for all, and the setting that a key means."""
    name = key.replace("-", "_")
    if name in SHARED:
        return "", Setting(name, Path if name.endswith("_file") else str, (name,))
    known = commands()
    found = max((one for one in known if name.startswith(f"{one}.")), key=len, default=None)
    if found is None:
        keys = ", ".join(SHARED)
        raise UsageError(f"unknown key {key}; write {keys}, or COMMAND.OPTION such as send.fps")
    options_type = options_type_of(known[found])
    if getattr(options_type, "OWN_FILE", False):
        raise UsageError(f"{spoken(found)} reads no profile; name a file with --config")
    settings = {one.name: one for one in settings_of(options_type)}
    option = name.removeprefix(f"{found}.")
    if option not in settings:
        raise UsageError(f"{spoken(found)} has no option {option}{hint(option, list(settings))}")
    return found, settings[option]
