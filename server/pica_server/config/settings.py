"""Settings from the command line, the environment and a TOML file, and where each came from.

    flags  >  environment  >  file  >  defaults

The nested dataclasses of a command's options are the schema: the field ``limits.joins_per_s`` is
the flag ``--limits.joins-per-s``, the variable ``PREFIX_LIMITS_JOINS_PER_S`` and, in the file, the
key ``joins_per_s`` of the table ``[limits]``. A new field needs nothing here.

What the file and the environment say becomes the defaults of the command line. Those are made
without their checks, because two settings that are wrong alone may be right together with a flag;
the checks run once, on what comes out. Nothing here reads the environment: it is an argument.
"""

import argparse
import copy
import difflib
import functools
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin
from typing import get_type_hints as hints_of

from pica_server.errors import ConfigurationError

T = TypeVar("T")

ELSEWHERE: Final = object()
"""Marks, in ``Annotated``, a field of the options that is no setting: the command line alone has
it."""

_SWITCHES: Final = {
    **dict.fromkeys(("true", "yes", "on", "1"), True),
    **dict.fromkeys(("false", "no", "off", "0"), False),
}
_WORDS: Final[dict[Any, str]] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    Path: "the name of a file",
}
_SECRET_NAMES: Final = ("secret", "password", "token", "credentials")
_USER_IN_URL: Final = re.compile(r"(?<=://)[^/@\s]*@")
_HIDDEN: Final = "***"


@dataclass(frozen=True, slots=True)
class Setting:
    """One field of the schema.

    Attributes:
        name: In the file, with a dot for each table.
        kind: ``bool``, ``int``, ``float``, ``str``, ``Path``, ``tuple`` of text or a ``Literal``.
        path: The attributes that lead to it from the options.
    """

    name: str
    kind: Any
    path: tuple[str, ...]

    @property
    def flag(self) -> str:
        """Its name on the command line."""
        return "--" + self.name.replace("_", "-")

    def variable(self, prefix: str) -> str:
        """Its name in the environment."""
        return prefix + self.name.replace(".", "_").upper()

    def made_of(self, value: Any) -> Any:
        """Return the value for what a file, or the environment, says."""
        return (
            value
            if get_origin(self.kind) is Literal
            else (get_origin(self.kind) or self.kind)(value)
        )

    def value_in(self, options: Any) -> Any:
        """Its value in options that have it."""
        return functools.reduce(getattr, self.path, options)

    def is_among(self, flags: set[str]) -> bool:
        """Whether the command line sets it."""
        table, _, last = self.flag.removeprefix("--").rpartition(".")
        negated = "--" + (f"{table}.no-{last}" if table else f"no-{last}")
        return self.flag in flags or negated in flags


@dataclass(frozen=True, slots=True)
class Effective:
    """A setting as it is, and who says so."""

    setting: Setting
    value: Any
    source: str


def settings_of(options_type: type) -> list[Setting]:
    """Return every setting of a tree of dataclasses, in the order of its fields.

    Raises:
        TypeError: A field has a type that no file could hold.
    """
    return list(_walk(options_type, "", ()))


def read_options(
    options_type: type[T],
    parse: Callable[[T], T],
    words: Sequence[str],
    environment: Mapping[str, str],
    *,
    prefix: str,
) -> tuple[T, list[Effective]]:
    """Put the sources together.

    Args:
        options_type: The schema, a dataclass.
        parse: Reads ``words`` with these defaults, which are not checked yet.
        words: The command line; ``--config FILE`` names the file.
        environment: Variables by name.
        prefix: The beginning of the names of our variables.

    Returns:
        The options, and every setting with its source.

    Raises:
        ConfigurationError: An unknown key or variable, a value of the wrong type or out of
            range; one line that says where.
    """
    settings = {setting.name: setting for setting in settings_of(options_type)}
    values: dict[Setting, Any] = {}
    sources: dict[Setting, str] = {}
    places: dict[Setting, str] = {}
    if {"-h", "--help"}.isdisjoint(words):
        file = _config_file(words, environment, prefix)
        for setting, value in _read_file(file, settings) if file is not None else ():
            values[setting], sources[setting] = setting.made_of(value), f"{file}"
            places[setting] = f"{file}: {setting.name}"
        for setting, value in _read_environment(environment, settings, prefix):
            values[setting] = setting.made_of(value)
            sources[setting] = places[setting] = setting.variable(prefix)
    flags = {word.partition("=")[0].replace("_", "-") for word in words if word[:2] == "--"}
    try:
        options = parse(_unchecked(options_type, values))
    except ConfigurationError as error:
        raise _with_source(error, places, flags) from error
    effective = []
    for setting in settings.values():
        source = setting.flag if setting.is_among(flags) else sources.get(setting, "default")
        effective.append(Effective(setting, setting.value_in(options), source))
    return options, effective


def as_toml(effective: Sequence[Effective]) -> str:
    """Write settings as a file that sets them, each with its source; without secrets."""
    lines = ["# flags > environment > file > defaults"]
    table = ""
    # Keys without a table must stand before the first one.
    for each in sorted(effective, key=lambda each: each.setting.name.rpartition(".")[0]):
        place, _, key = each.setting.name.rpartition(".")
        if place != table:
            lines += ["", f"[{place}]"]
            table = place
        if each.value is None:
            lines.append(f"# {key} is not set  # {each.source}")
        else:
            lines.append(f"{key} = {_toml(_shown(each))}  # {each.source}")
    return "\n".join(lines) + "\n"


def as_plain(effective: Sequence[Effective]) -> dict[str, dict[str, Any]]:
    """Return name to value and source, without secrets."""
    return {
        each.setting.name: {"value": _plain(_shown(each)), "source": each.source}
        for each in effective
    }


def _walk(cls: type, table: str, path: tuple[str, ...]) -> Iterator[Setting]:
    hints = hints_of(cls, include_extras=True)
    for field in fields(cls):
        kind, marks = hints[field.name], list[Any]()
        if get_origin(kind) is Annotated:
            kind, *marks = get_args(kind)
        if ELSEWHERE in marks:
            continue
        here = (*path, field.name)
        if is_dataclass(kind) and isinstance(kind, type):
            # Fields of a nameless group stand beside those of its owner.
            is_nameless = any(getattr(mark, "name", None) == "" for mark in marks)
            yield from _walk(kind, table if is_nameless else f"{table}{field.name}.", here)
            continue
        if get_origin(kind) in (Union, UnionType):
            kind, *others = [one for one in get_args(kind) if one is not NoneType]
            if others:
                raise TypeError(f"{cls.__name__}.{field.name}: a setting has one type")
        is_simple = kind in (bool, int, float, str, Path) or get_origin(kind) is Literal
        if not is_simple and kind != tuple[str, ...]:
            raise TypeError(f"{cls.__name__}.{field.name}: {kind} fits no file")
        yield Setting(f"{table}{field.name}", kind, here)


def _config_file(words: Sequence[str], environment: Mapping[str, str], prefix: str) -> Path | None:
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config", nargs="?", default=environment.get(f"{prefix}CONFIG"))
    name = parser.parse_known_args(words)[0].config
    return Path(name) if name else None


def _read_file(file: Path, settings: Mapping[str, Setting]) -> Iterator[tuple[Setting, Any]]:
    try:
        document = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(f"--config {file}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"--config {file}: no UTF-8 text at byte {error.start}") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"--config {file}: no TOML: {error}") from error
    tables = {name.rpartition(".")[0] for name in settings}
    for name, value in _leaves(document, tables, ""):
        setting = settings.get(name)
        if setting is None and name in tables:
            raise ConfigurationError(f"{file}: {name} must be a table, [{name}]")
        if setting is None:
            raise ConfigurationError(f"{file}: unknown key {name}{_hint(name, list(settings))}")
        if not _fits(setting.kind, value):
            wanted = _wanted(setting.kind, 'a list of text, ["…", "…"]')
            is_simple = isinstance(value, (bool, int, float, str))
            said = _cut(_toml(value) if is_simple else ascii(value))
            raise ConfigurationError(f"{file}: {name} = {said} must be {wanted}")
        yield setting, file.parent / value if setting.kind is Path else value


def _leaves(table: Mapping[str, Any], tables: set[str], prefix: str) -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        name = f"{prefix}{key}"
        if name in tables and isinstance(value, dict):
            yield from _leaves(value, tables, f"{name}.")
        else:
            yield name, value


def _read_environment(
    environment: Mapping[str, str], settings: Mapping[str, Setting], prefix: str
) -> Iterator[tuple[Setting, Any]]:
    known = {setting.variable(prefix): setting for setting in settings.values()}
    for variable, text in sorted(environment.items()):
        if not variable.startswith(prefix) or variable == f"{prefix}CONFIG":
            continue
        setting = known.get(variable)
        if setting is None:
            hint = _hint(variable, list(known))
            raise ConfigurationError(f"unknown environment variable {variable}{hint}")
        if not text:  # empty is not set: a compose file cannot leave a variable out
            continue
        value = _from_text(setting.kind, text)
        if not _fits(setting.kind, value):
            # Kubernetes sets NAME_PORT and others for each service; see docs/operating.md.
            hint = "; it is Kubernetes that set this: use `enableServiceLinks: false`"
            raise ConfigurationError(
                f"{variable}={_cut(text)} must be {_wanted(setting.kind, 'text, text, …')}"
                f"{hint if text.startswith('tcp://') else ''}"
            )
        yield setting, value


def _from_text(kind: Any, text: str) -> Any:
    """Return what the same would be in the file; None for what cannot be read."""
    if kind is bool:
        return _SWITCHES.get(text.lower())
    if kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            return None
    if get_origin(kind) is tuple:
        return [item.strip() for item in text.split(",") if item.strip()]
    return text


def _fits(kind: Any, value: Any) -> bool:
    if get_origin(kind) is Literal:
        return value in get_args(kind)
    if get_origin(kind) is tuple:
        return isinstance(value, list) and all(isinstance(item, str) for item in value)
    types = {float: (int, float), Path: (str,)}.get(kind, (kind,))
    return type(value) in types


def _wanted(kind: Any, list_of_text: str) -> str:
    if get_origin(kind) is Literal:
        return "one of " + ", ".join(map(str, get_args(kind)))
    if get_origin(kind) is tuple:
        return list_of_text
    return _WORDS[kind]


def _unchecked(options_type: type[T], values: Mapping[Setting, Any]) -> T:
    """Make defaults that may be wrong until the command line is added to them."""
    options = copy.deepcopy(options_type())
    for setting, value in values.items():
        owner = functools.reduce(getattr, setting.path[:-1], options)
        object.__setattr__(owner, setting.path[-1], value)
    return options


def _with_source(
    error: ConfigurationError, sources: Mapping[Setting, str], flags: set[str]
) -> ConfigurationError:
    """Say of a refused value where it stands, if that is not the command line.

    The checks begin with the flag of the field that they are about.
    """
    flag, text = re.match(r"(--[a-z0-9.-]+)?(.*)", str(error), re.DOTALL).groups()  # type: ignore[union-attr]
    for setting, source in sources.items():
        if setting.flag == flag and not setting.is_among(flags):
            return ConfigurationError(f"{source}{text}")
    return error


GONE = ("coalesce_above_busy", "coalesce_longest_s")
"""Settings of former releases that have no successor: frames do not wait for others any more."""


def _hint(name: str, known: list[str]) -> str:
    if name.replace("-", "_").lower().endswith(GONE):
        return "; this setting has gone, leave it out"
    near = difflib.get_close_matches(name.replace("-", "_"), known, n=1, cutoff=0.5)
    if near:
        return f"; did you mean {near[0]}?"
    return "; `pica relay --print-config` lists them"


def one_line(box: str) -> str:
    """Return what the parser of the command line says in a box of many lines."""
    lines = [line.strip("│╭╮╰╯ ") for line in box.splitlines()]
    parts = " ".join(line for line in lines[1:] if line).split("───")
    text = parts[0].strip(" ─.") or "bad usage"
    near = re.search(r"Perhaps you meant:\s+(--[a-z0-9.-]+)", " ".join(lines))
    if any(name.replace("_", "-") in text for name in GONE):
        return f"{text}; this setting has gone, leave it out"
    return text + (f"; did you mean {near[1]}?" if near else "; `--help` lists all options")


def without_user(text: str) -> str:
    """Hide user and password in an address."""
    return _USER_IN_URL.sub(f"{_HIDDEN}@", text)


def _shown(each: Effective) -> Any:
    name = each.setting.name.rpartition(".")[2]
    if not isinstance(each.value, str):
        return each.value
    if each.value and any(word in name.split("_") for word in _SECRET_NAMES):
        return _HIDDEN
    return without_user(each.value)


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return list(value)
    return str(value) if isinstance(value, Path) else value


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    text = str(value).replace("\\", "\\\\").replace('"', '\\"')
    text = "".join(one if one.isprintable() else f"\\U{ord(one):08x}" for one in text)
    return f'"{text}"'


def _toml_or_repr(value: Any) -> str:
    return _toml(value) if isinstance(value, (bool, int, float, str)) else ascii(value)


def _cut(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."
