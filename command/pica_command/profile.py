"""Where the options of a command come from besides its words: variables, and a profile.

    flags  >  environment  >  profile  >  defaults

``PICA_<COMMAND>_<OPTION>`` sets an option of one command: ``PICA_SEND_FPS``, and for ``pica avatar
push`` ``PICA_AVATAR_PUSH_URL``. ``PICA_<OPTION>`` sets it for every command that meets others in a
room: those whose options name it in ``SHARED``. In the profile these stand at the top, and the
options of one command in its table.

A command whose options set ``OWN_FILE``, as the relay's, reads the file that ``--config`` or
``PICA_RELAY_CONFIG`` names instead of the profile: a service is not set up by somebody's habits.
"""

import argparse
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

from platformdirs import PlatformDirs

from pica_command.errors import UsageError
from pica_command.extras import DISTRIBUTION
from pica_command.settings import (
    Said,
    Setting,
    hint,
    read_file,
    read_options,
    said_in_file,
    settings_of,
    toml_value,
    value_of_text,
)

T = TypeVar("T")

SHARED: Final = ("url", "room", "name", "token_file", "ca_file", "secret_file")
"""Options that all commands which meet others in a room may have in common."""
PROFILE_VARIABLE: Final = "PICA_PROFILE"
"""Names another profile; ``none`` is to use none."""


def prefix_of(command: str) -> str:
    """The beginning of the variables of a command."""
    return f"PICA_{command.replace('.', '_').upper()}_"


def variables_of(command: str, options_type: type) -> dict[str, Setting]:
    """The variables that a command reads; one of its own goes before a shared one."""
    settings = settings_of(options_type)
    shared = getattr(options_type, "SHARED", ())
    common = {one.variable("PICA_"): one for one in settings if one.name in shared}
    return common | {one.variable(prefix_of(command)): one for one in settings}


def read_command(
    command: str,
    options_type: type[T],
    words: Sequence[str],
    environment: Mapping[str, str],
    parse: Callable[[Sequence[str]], T],
) -> tuple[T, dict[Setting, Said]]:
    """Read a command's options from everywhere.

    Args:
        command: Its name, with dots.
        words: What was typed after it.
        parse: Reads words into options.

    Returns:
        The options, and every setting with its source.

    Raises:
        UsageError: An unknown key or variable, or a value that cannot be; names its place.
    """
    own_file = getattr(options_type, "OWN_FILE", False)
    if own_file:
        file, words = _named_file(words, environment.get(f"{prefix_of(command)}CONFIG"))
    if not {"-h", "--help"}.isdisjoint(words):
        return parse(words), {}
    if own_file:
        in_file = said_in_file(file, read_file(file), settings_of(options_type)) if file else {}
    else:
        in_file = _said_in_profile(command, options_type, profile_path(environment))
    in_environment = _said_in_environment(command, options_type, environment)
    return read_options(options_type, parse, words, [in_environment, in_file])


def profile_path(environment: Mapping[str, str]) -> Path | None:
    """Where the profile is, or would be; None if none is to be used."""
    named = environment.get(PROFILE_VARIABLE)
    if named:
        return None if named == "none" else Path(named)
    folder = PlatformDirs(DISTRIBUTION, appauthor=False, roaming=True).user_config_path
    return folder / "profile.toml"


def read_profile(path: Path) -> dict[str, Any]:
    """What stands in a profile; nothing if there is none.

    Raises:
        UsageError: It is no TOML, or cannot be read.
    """
    return read_file(path) if path.exists() else {}


def write_profile(path: Path, document: Mapping[str, Any]) -> None:
    """Write a profile that its owner alone can read: whole, or not at all.

    Where a symbolic link leads to it, the link stays.

    Raises:
        UsageError: The system says no.
    """
    try:
        target = Path(os.path.realpath(path))
        target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        # A temporary file is its owner's alone from its first moment.
        descriptor, part = tempfile.mkstemp(dir=target.parent, prefix=target.name)
        try:
            with open(descriptor, "w", encoding="utf-8") as file:
                file.write("\n".join([*_toml_lines(document), ""]))
            os.replace(part, target)
        except OSError:
            os.unlink(part)
            raise
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error


def _toml_lines(table: Mapping[str, Any], name: str = "") -> list[str]:
    """A table, its own keys first, and those in it."""
    inner = {key: value for key, value in table.items() if isinstance(value, dict)}
    lines = [f"{key} = {toml_value(table[key])}" for key in table if key not in inner]
    if name and lines:
        lines = ["", f"[{name}]", *lines]
    for key, value in inner.items():
        lines += _toml_lines(value, f"{name}.{key}".lstrip("."))
    return lines


def _named_file(words: Sequence[str], default: str | None) -> tuple[Path | None, list[str]]:
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--config", default=default)
    try:
        found, rest = parser.parse_known_args(words)
    except argparse.ArgumentError:
        raise UsageError("--config needs the name of a file behind it") from None
    return (Path(found.config) if found.config else None), rest


def _said_in_environment(
    command: str, options_type: type, environment: Mapping[str, str]
) -> dict[Setting, Said]:
    variables = variables_of(command, options_type)
    prefix = prefix_of(command)
    # `PICA_TOKEN_FILE` is for those who join, whatever options `pica token` has.
    known = {*variables, f"{prefix}CONFIG", *(f"PICA_{name.upper()}" for name in SHARED)}
    for variable in sorted(environment):
        if variable.startswith(prefix) and variable not in known:
            raise UsageError(
                f"unknown environment variable {variable}{hint(variable, list(variables))}"
            )
    return {
        setting: Said(value_of_text(setting, text, variable), variable, variable)
        for variable, setting in variables.items()
        if (text := environment.get(variable))  # empty is not set: compose files leave none out
    }


def _said_in_profile(command: str, options_type: type, path: Path | None) -> dict[Setting, Said]:
    if path is None:
        return {}
    document = read_profile(path)
    settings = settings_of(options_type)
    top = {key: value for key, value in document.items() if not isinstance(value, dict)}
    for key in top:
        if key not in SHARED:
            raise UsageError(
                f"{path}: unknown key {key}; above the tables may stand {', '.join(SHARED)}"
            )
    shared = {name: top[name] for name in getattr(options_type, "SHARED", ()) if name in top}
    own: Any = document
    for word in command.split("."):
        own = own.get(word, {}) if isinstance(own, dict) else {}
    if not isinstance(own, dict):
        raise UsageError(f"{path}: {command} must be a table, [{command}]")
    return said_in_file(path, shared, settings) | said_in_file(path, own, settings)
