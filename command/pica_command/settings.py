"""Options from the command line, the environment and a TOML file, and where each came from.

    flags  >  environment  >  file  >  defaults

The nested dataclasses of a command's options are the schema: the field ``limits.joins_per_s`` is
the flag ``--limits.joins-per-s``, the variable ``PREFIX_LIMITS_JOINS_PER_S`` and, in the file, the
key ``joins_per_s`` of the table ``[limits]``. A new field needs nothing here.

What the file and the environment say is added to the command line, where no flag says otherwise.
So everything is read and checked once, together: two settings that are wrong alone may be right
with each other. Nothing here reads the environment or finds files: they are arguments.
"""

import difflib
import functools
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin
from typing import get_type_hints as hints_of

from pica_command.errors import UsageError
from pica_command.parsing import GONE

T = TypeVar("T")

_SWITCHES: Final = {
    **dict.fromkeys(("true", "yes", "on", "1"), True),
    **dict.fromkeys(("false", "no", "off", "0"), False),
}
_WORDS: Final[dict[Any, tuple[str, str]]] = {
    bool: ("true or false", "switches"),
    int: ("a whole number", "whole numbers"),
    float: ("a number", "numbers"),
    str: ("text", "text"),
    Path: ("the name of a file", "names of files"),
}
"""What errors call one value of a type, and several."""
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
        is_switch: Its flag takes no word: a ``bool`` that is never absent.
    """

    name: str
    kind: Any
    path: tuple[str, ...]
    is_switch: bool = False

    @property
    def flag(self) -> str:
        """Its name on the command line."""
        return "--" + self.name.replace("_", "-")

    def variable(self, prefix: str) -> str:
        """Its name in the environment."""
        return prefix + self.name.replace(".", "_").upper()

    @property
    def negation(self) -> str:
        """The flag that turns a switch off."""
        table, dot, last = self.name.rpartition(".")
        return f"--{table}{dot}no-{last}".replace("_", "-")

    def words_for(self, value: Any) -> list[str]:
        """How the command line would say what a file, or the environment, says."""
        if self.is_switch:
            return [self.flag if value else self.negation]
        if get_origin(self.kind) is tuple:
            return [self.flag, *map(str, value)]
        return [f"{self.flag}={value}"]

    def value_in(self, options: Any) -> Any:
        """Its value in options that have it."""
        return functools.reduce(getattr, self.path, options)

    def is_among(self, flags: set[str]) -> bool:
        """Whether the command line sets it."""
        return not flags.isdisjoint((self.flag, self.negation))


@dataclass(frozen=True, slots=True)
class Said:
    """What is said of a setting.

    Attributes:
        value: As TOML would give it, or as the options have it.
        source: The variable, the name of the file, the flag, or "default".
        place: The variable, or the name of the file and the key in it; empty for the others.
    """

    value: Any
    source: str
    place: str = ""


def settings_of(options_type: type) -> list[Setting]:
    """Return every setting of a tree of dataclasses, in the order of its fields.

    Raises:
        TypeError: A field has a type that no file could hold.
    """
    return list(_walk(options_type, "", ()))


def read_options(
    options_type: type[T],
    parse: Callable[[Sequence[str]], T],
    words: Sequence[str],
    sources: Sequence[Mapping[Setting, Said]],
) -> tuple[T, dict[Setting, Said]]:
    """Put the sources together.

    Args:
        options_type: The schema, a dataclass.
        parse: Reads a command line.
        words: The command line.
        sources: What files and environment say; an earlier one goes before a later one.

    Returns:
        The options, and every setting with its source.

    Raises:
        UsageError: A value of a file or of the environment is refused; says where it stands.
    """
    end = words.index("--") if "--" in words else len(words)
    flags = {word.partition("=")[0].replace("_", "-") for word in words[:end] if word[:2] == "--"}
    said: dict[Setting, Said] = {}
    for source in reversed(sources):
        said |= {one: value for one, value in source.items() if not one.is_among(flags)}
    added = [word for setting, each in said.items() for word in setting.words_for(each.value)]
    with naming_places(said):
        options = parse([*words[:end], *added, *words[end:]])
    effective = {}
    for setting in settings_of(options_type):
        default = Said(None, setting.flag if setting.is_among(flags) else "default")
        effective[setting] = replace(said.get(setting, default), value=setting.value_in(options))
    return options, effective


def as_toml(effective: Mapping[Setting, Said], command: str = "") -> str:
    """Write settings as a file that sets them, each with its source; without secrets.

    Args:
        command: The table that they stand in, as in a profile.
    """
    lines = ["# flags > environment > file > defaults"]
    table = ""
    named = [(f"{command}.{setting.name}".lstrip("."), setting) for setting in effective]
    # Keys without a table must stand before the first one.
    for name, setting in sorted(named, key=lambda pair: pair[0].rpartition(".")[0]):
        place, _, key = name.rpartition(".")
        if place != table:
            lines += ["", f"[{place}]"]
            table = place
        value, source = _shown(setting, effective[setting].value), effective[setting].source
        told = f"# {key} is not set" if value is None else f"{key} = {toml_value(value)}"
        lines.append(f"{told}  # {source}")
    return "\n".join(lines) + "\n"


def as_plain(effective: Mapping[Setting, Said]) -> dict[str, dict[str, Any]]:
    """Return name to value and source, without secrets."""
    plain = {}
    for setting, said in effective.items():
        value = _shown(setting, said.value)
        value = str(value) if isinstance(value, Path) else value
        plain[setting.name] = {"value": value, "source": said.source}
    return plain


def _walk(cls: type, table: str, path: tuple[str, ...]) -> Iterator[Setting]:
    from tyro.conf import OmitArgPrefixes, Positional  # loaded by the options already
    from tyro.constructors import PrimitiveConstructorSpec

    cls, chosen = get_origin(cls) or cls, get_args(cls)  # of a generic class, what it is of
    parameters = dict(zip(getattr(cls, "__parameters__", ()), chosen, strict=True))
    hints = hints_of(cls, include_extras=True)
    for field in fields(cls):
        kind, marks = hints[field.name], list[Any]()
        if get_origin(kind) is Annotated:
            kind, *marks = get_args(kind)
        kind = parameters.get(kind, kind)
        if Positional in marks or get_origin(kind) is Mapping:  # flags alone say the latter
            continue
        names = [mark.name for mark in marks if getattr(mark, "name", None) is not None]
        name = names[0] if names else field.name
        here = (*path, field.name)
        if any(isinstance(mark, PrimitiveConstructorSpec) for mark in marks):
            kind = str  # made of one word by a rule of its own
        if is_dataclass(kind) and isinstance(kind, type):
            # Fields of a nameless group stand beside those of its owner.
            is_nameless = name == "" or OmitArgPrefixes in marks
            yield from _walk(kind, table if is_nameless else f"{table}{name}.", here)
            continue
        is_switch = kind is bool
        if get_origin(kind) in (Union, UnionType):
            kind, *others = [one for one in get_args(kind) if one is not NoneType]
            if others:
                raise TypeError(f"{cls.__name__}.{field.name}: a setting has one type")
        is_list = get_origin(kind) is tuple and get_args(kind)[1:] == (...,)
        item = get_args(kind)[0] if is_list else kind
        if item not in _WORDS and get_origin(item) is not Literal:
            raise TypeError(f"{cls.__name__}.{field.name}: {kind} fits no file")
        yield Setting(f"{table}{name}".replace("-", "_"), kind, here, is_switch)


def read_file(file: Path) -> dict[str, Any]:
    """Return what stands in a TOML file.

    Raises:
        UsageError: There is none, or it is no TOML.
    """
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{file}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{file}: no UTF-8 text at byte {error.start}") from error
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{file}: no TOML: {error}") from error


def said_in_file(
    file: Path, document: Mapping[str, Any], settings: Sequence[Setting]
) -> dict[Setting, Said]:
    """Find what a document, read from `file`, says of settings.

    Raises:
        UsageError: An unknown key, or a value of the wrong type.
    """
    by_name = {setting.name: setting for setting in settings}
    tables = {name.rpartition(".")[0] for name in by_name}
    said = {}
    for name, value in _leaves(document, tables, ""):
        setting = by_name.get(name)
        if setting is None and name in tables:
            raise UsageError(f"{file}: {name} must be a table, [{name}]")
        if setting is None:
            raise UsageError(f"{file}: unknown key {name}{hint(name, list(by_name))}")
        if not _fits(setting.kind, value):
            wanted = _wanted(setting.kind, '["…", "…"]')
            is_simple = isinstance(value, (bool, int, float, str))
            shown = _cut(toml_value(value) if is_simple else ascii(value))
            raise UsageError(f"{file}: {name} = {shown} must be {wanted}")
        if setting.kind is Path:
            value = file.parent / Path(value).expanduser()
        said[setting] = Said(value, f"{file}", f"{file}: {name}")
    return said


def _leaves(table: Mapping[str, Any], tables: set[str], prefix: str) -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        name = f"{prefix}{key}"
        if name in tables and isinstance(value, dict):
            yield from _leaves(value, tables, f"{name}.")
        else:
            yield name, value


def value_of_text(setting: Setting, text: str, place: str) -> Any:
    """Return what a file would say, for a text from the environment or the command line.

    Raises:
        UsageError: It is of the wrong type; the error begins with `place`.
    """
    value = _from_text(setting.kind, text)
    if not _fits(setting.kind, value):
        # Kubernetes sets NAME_PORT and others for each service; see docs/operating.md.
        fix = "; it is Kubernetes that set this: use `enableServiceLinks: false`"
        raise UsageError(
            f"{place}={_cut(text)} must be {_wanted(setting.kind, 'with commas between')}"
            f"{fix if text.startswith('tcp://') else ''}"
        )
    return value


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
        items = (item.strip() for item in text.split(","))
        return [_from_text(get_args(kind)[0], item) for item in items if item]
    if get_origin(kind) is Literal:
        return next((choice for choice in get_args(kind) if str(choice) == text), None)
    return text


def _fits(kind: Any, value: Any) -> bool:
    if get_origin(kind) is Literal:
        return value in get_args(kind)
    if get_origin(kind) is tuple:
        return isinstance(value, list) and all(_fits(get_args(kind)[0], item) for item in value)
    types = {float: (int, float), Path: (str,)}.get(kind, (kind,))
    return type(value) in types


def _wanted(kind: Any, form_of_list: str) -> str:
    if get_origin(kind) is Literal:
        return "one of " + ", ".join(map(str, get_args(kind)))
    if get_origin(kind) is tuple:
        return f"a list of {_WORDS[get_args(kind)[0]][1]}, {form_of_list}"
    return _WORDS[kind][0]


@contextmanager
def naming_places(said: Mapping[Setting, Said]) -> Iterator[None]:
    """Let an error about a setting say where it stands, if that is not the command line.

    Errors about a setting begin with its flag or its name.

    Raises:
        UsageError: The error, with the place in front, and its own exit status.
    """
    try:
        yield
    except Exception as error:
        if not hasattr(error, "exit_code"):  # a bug of ours
            raise
        first, _, text = str(error).partition(" ")
        name = first.removeprefix("--").replace("-", "_")
        place = next((each.place for one, each in said.items() if one.name == name), "")
        if not place:
            raise
        named = UsageError(f"{place} {text}")
        named.exit_code = error.exit_code
        raise named from error


def hint(name: str, known: list[str]) -> str:
    """What follows "unknown NAME": a former or a similar name, or where all are listed."""
    if name.replace("-", "_").lower().endswith(GONE):
        return "; this setting has gone, leave it out"
    near = difflib.get_close_matches(name.replace("-", "_"), known, n=1, cutoff=0.5)
    if near:
        return f"; did you mean {near[0]}?"
    return "; --print-config lists them"


def _shown(setting: Setting, value: Any) -> Any:
    """A value without secrets, and an address without user and password."""
    if not isinstance(value, str):
        return value
    words = setting.name.rpartition(".")[2].split("_")
    if value and not set(words).isdisjoint(_SECRET_NAMES):
        return _HIDDEN
    return _USER_IN_URL.sub(f"{_HIDDEN}@", value)


def toml_value(value: Any) -> str:
    """Write a value as TOML does."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    text = str(value).replace("\\", "\\\\").replace('"', '\\"')
    text = "".join(one if one.isprintable() else f"\\U{ord(one):08x}" for one in text)
    return f'"{text}"'


def _cut(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."
