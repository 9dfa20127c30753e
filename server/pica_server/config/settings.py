"""Settings from the command line, the environment and a TOML file, and where each came from.

    flags  >  environment  >  file  >  defaults

The nested dataclasses of a command's options are the schema: the field ``limits.joins_per_s`` is
the flag ``--limits.joins-per-s``, the variable ``PREFIX_LIMITS_JOINS_PER_S`` and, in the file, the
key ``joins_per_s`` of the table ``[limits]``. A new field needs nothing here.

What the file and the environment say becomes the defaults of the command line. Those are made
without their checks, because two settings that are wrong alone may be right together with a flag;
the checks run once, on what comes out. Nothing here reads the environment: it is an argument.
"""

import difflib
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin
from typing import get_type_hints as hints_of

from pica_server.errors import ConfigurationError

T = TypeVar("T")

ELSEWHERE: Final = object()
"""Marks, in ``Annotated``, a field of the options that is no setting: the command line alone has
it."""

_TRUE, _FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")
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
        is_optional: Whether it may be None.
    """

    name: str
    kind: Any
    path: tuple[str, ...]
    is_optional: bool

    @property
    def flag(self) -> str:
        """Its name on the command line."""
        return "--" + self.name.replace("_", "-")

    def variable(self, prefix: str) -> str:
        """Its name in the environment."""
        return prefix + self.name.replace(".", "_").upper()

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
        parse: Reads ``words`` with these defaults. The defaults are not checked yet.
        words: The command line; ``--config FILE`` names the file.
        environment: The environment.
        prefix: What the names of our variables begin with.

    Returns:
        The options, and every setting with its source.

    Raises:
        ConfigurationError: A key or variable nobody knows, a value of the wrong type or out of
            range; one line that says where.
    """
    settings = {setting.name: setting for setting in settings_of(options_type)}
    values: dict[str, Any] = {}
    sources: dict[str, str] = {}
    asks_for_help = not {"-h", "--help"}.isdisjoint(words)
    file = _config_file(words, environment, prefix)
    if file is not None and not asks_for_help:
        for name, value in _read_file(file, settings).items():
            values[name], sources[name] = value, f"{file}"
    if not asks_for_help:
        for name, (variable, value) in _read_environment(environment, settings, prefix).items():
            values[name], sources[name] = value, variable
    flags = {word.partition("=")[0].replace("_", "-") for word in words if word[:2] == "--"}
    try:
        options = parse(_unchecked(options_type, settings, values))
    except ConfigurationError as error:
        raise _with_source(error, settings, sources, flags, prefix) from error
    effective = []
    for setting in settings.values():
        found: Any = options
        for attribute in setting.path:
            found = getattr(found, attribute)
        source = setting.flag if setting.is_among(flags) else sources.get(setting.name, "default")
        effective.append(Effective(setting, found, source))
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
        is_optional = False
        if get_origin(kind) in (Union, UnionType):
            is_optional = NoneType in get_args(kind)
            kind, *others = [one for one in get_args(kind) if one is not NoneType]
            if others:
                raise TypeError(f"{cls.__name__}.{field.name}: a setting has one type")
        is_simple = kind in (bool, int, float, str, Path) or get_origin(kind) is Literal
        if not is_simple and kind != tuple[str, ...]:
            raise TypeError(f"{cls.__name__}.{field.name}: {kind} fits no file")
        yield Setting(f"{table}{field.name}", kind, here, is_optional)


def _config_file(words: Sequence[str], environment: Mapping[str, str], prefix: str) -> Path | None:
    name = environment.get(f"{prefix}CONFIG", "")
    for i, word in enumerate(words):
        if word == "--config":
            name = "".join(words[i + 1 : i + 2])
        elif word.startswith("--config="):
            name = word.partition("=")[2]
    return Path(name) if name else None


def _read_file(file: Path, settings: Mapping[str, Setting]) -> dict[str, Any]:
    try:
        document = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(f"--config {file}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"--config {file}: no UTF-8 text at byte {error.start}") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"--config {file}: no TOML: {error}") from error
    values = {}
    for name, value in _leaves(document, settings, ""):
        setting = settings.get(name)
        if setting is None and any(known.startswith(f"{name}.") for known in settings):
            raise ConfigurationError(f"{file}: {name} must be a table, [{name}]")
        if setting is None:
            raise ConfigurationError(f"{file}: unknown key {name}{_hint(name, list(settings))}")
        values[name] = _from_toml(setting, value, file)
    return values


def _leaves(
    table: Mapping[str, Any], settings: Mapping[str, Setting], prefix: str
) -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        name = f"{prefix}{key}"
        is_table = any(known.startswith(f"{name}.") for known in settings)
        if is_table and not isinstance(value, dict):
            yield name, value
        elif is_table:
            yield from _leaves(value, settings, f"{name}.")
        else:
            yield name, value


def _from_toml(setting: Setting, value: Any, file: Path) -> Any:
    kind = setting.kind
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if kind is float and is_number:
        return float(value)
    if kind is int and is_number and not isinstance(value, float):
        return value
    if kind in (bool, str) and isinstance(value, kind):
        return value
    if kind is Path and isinstance(value, str):
        return file.parent / value
    if get_origin(kind) is Literal and value in get_args(kind):
        return value
    is_texts = isinstance(value, list) and all(isinstance(item, str) for item in value)
    if get_origin(kind) is tuple and is_texts:
        return tuple(value)
    raise ConfigurationError(
        f"{file}: {setting.name} = {_cut(_toml_or_repr(value))} must be {_wanted(setting, 'file')}"
    )


def _read_environment(
    environment: Mapping[str, str], settings: Mapping[str, Setting], prefix: str
) -> dict[str, tuple[str, Any]]:
    known = {setting.variable(prefix): setting for setting in settings.values()}
    values = {}
    for variable, text in sorted(environment.items()):
        if not variable.startswith(prefix) or variable == f"{prefix}CONFIG":
            continue
        setting = known.get(variable)
        if setting is None:
            hint = _hint(variable, list(known))
            raise ConfigurationError(f"unknown environment variable {variable}{hint}")
        if text:  # empty is not set: a compose file cannot leave a variable out
            values[setting.name] = (variable, _from_text(setting, text, variable))
    return values


def _from_text(setting: Setting, text: str, variable: str) -> Any:
    kind = setting.kind
    if kind in (str, Path):
        return kind(text)
    if get_origin(kind) is tuple:
        return tuple(item.strip() for item in text.split(",") if item.strip())
    if kind is bool and text.lower() in (*_TRUE, *_FALSE):
        return text.lower() in _TRUE
    if get_origin(kind) is Literal and text in get_args(kind):
        return text
    if kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    hint = ""
    if text.startswith("tcp://"):
        # Kubernetes sets NAME_PORT and others for each service; see docs/operating.md.
        hint = "; it is Kubernetes that set this: use `enableServiceLinks: false`"
    raise ConfigurationError(
        f"{variable}={_cut(text)} must be {_wanted(setting, 'environment')}{hint}"
    )


def _wanted(setting: Setting, place: str) -> str:
    kind = setting.kind
    if get_origin(kind) is Literal:
        return "one of " + ", ".join(map(str, get_args(kind)))
    if get_origin(kind) is tuple:
        return 'a list of text, ["…", "…"]' if place == "file" else "text, text, …"
    if kind is bool:
        return "true or false"
    words = {int: "a whole number", float: "a number", str: "text", Path: "the name of a file"}
    return words[kind]


def _unchecked(
    cls: Any, settings: Mapping[str, Setting], values: Mapping[str, Any], path: tuple[str, ...] = ()
) -> Any:
    """Make defaults that may be wrong until the command line is added to them."""
    by_path = {settings[name].path: value for name, value in values.items()}
    hints = hints_of(cls)
    instance = object.__new__(cls)
    for field in fields(cls):
        here = (*path, field.name)
        kind = hints[field.name]
        if here in by_path:
            value = by_path[here]
        elif any(known[: len(here)] == here for known in by_path) and is_dataclass(kind):
            value = _unchecked(kind, settings, values, here)
        else:
            value = _default(field)
        object.__setattr__(instance, field.name, value)
    return instance


def _default(field: "Field[Any]") -> Any:
    if field.default_factory is not MISSING:
        return field.default_factory()
    if field.default is MISSING:
        raise TypeError(f"{field.name}: a setting has a default")
    return field.default


def _with_source(
    error: ConfigurationError,
    settings: Mapping[str, Setting],
    sources: Mapping[str, str],
    flags: set[str],
    prefix: str,
) -> ConfigurationError:
    """Say of a refused value where it stands, if that is not the command line.

    The checks begin with the flag of the field that they are about.
    """
    text = str(error)
    flag = re.match(r"--[a-z0-9.-]+", text)
    for setting in settings.values():
        if flag is None or setting.flag != flag[0] or setting.is_among(flags):
            continue
        source = sources.get(setting.name)
        if source is not None:
            is_variable = source == setting.variable(prefix)
            where = source if is_variable else f"{source}: {setting.name}"
            return ConfigurationError(f"{where}{text[len(flag[0]) :]}")
    return error


def _hint(name: str, known: list[str]) -> str:
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
