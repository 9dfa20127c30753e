"""Options of a command from its words, the environment and a TOML file; cyclopts reads them.

    flags  >  environment  >  file  >  defaults

A command's options are a frozen dataclass. The option ``--limits.joins-per-s`` of ``pica relay`` is
the variable ``PICA_RELAY_LIMITS_JOINS_PER_S`` and the key ``joins_per_s`` of the table
``[relay.limits]``. The file is the user's, or the one that ``--config`` or ``PICA_CONFIG`` names.
Commands that join a room share a few options: ``PICA_URL``, and ``url`` above all tables.
"""

import inspect
import re
import tomllib
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import App, Argument, ArgumentCollection, CycloptsError, Group, Parameter, Token

from pica_command.table import COMMANDS, SHARED, Command, UsageError

COMMON: Final = {
    "config": (Path | None, None, "Read options from this TOML file, not from the user's."),
    "json": (bool, False, "Print the result, or the error, as the last line of stdout."),
    "debug": (bool, False, "Show the traceback of an error."),
}
"""Type, default and text of the options that every command takes."""
_GROUP = Group("Common", sort_key=1)
_SECTION = re.compile(r"^(Args|Returns|Raises|Attributes|Not checked|Source):", re.MULTILINE)


class CommandLine:
    """One command with its options, as cyclopts reads them.

    Args:
        name: Its words.
        row: Its row of the table; its module is imported here.
        environment: The variables of the process.
        file: The file of options, if no flag names another; None if there is none.
    """

    def __init__(
        self, name: str, row: Command, environment: Mapping[str, str], file: Path | None
    ) -> None:
        self.function = row.load()
        self._name = name
        self._shared = SHARED if row.joins else ()
        self._environment = environment
        self._file = file
        self.app = App(
            name=f"pica {name}",
            help=_description(self.function),
            help_format="markdown",
            group_commands=_GROUP,
            help_flags=("--help", "-h"),
            version_flags=(),
            default_parameter=Parameter(consume_multiple=True, negative_iterable=()),
            config=self._add_tokens,
        )
        self._take = _taker(self.function)
        self.app.default(self._take)

    def read(self, words: Sequence[str]) -> dict[str, Any] | None:
        """Read the options: the arguments for the function; None after help was printed.

        Raises:
            UsageError: A word, variable or key is unknown, or its value is refused; names it.
        """
        try:
            take, bound, _ = self.app.parse_args(words, exit_on_error=False, print_error=False)
        except CycloptsError as error:
            raise UsageError(" ".join(str(error).split())) from error
        if take is not self._take:
            take(*bound.args, **bound.kwargs)
            return None
        bound.apply_defaults()
        return {name: each for name, each in bound.arguments.items() if name not in COMMON}

    def _add_tokens(
        self, _app: App, _commands: tuple[str, ...], arguments: ArgumentCollection
    ) -> None:
        """Add what environment and file say of arguments that no flag sets."""
        leaves = {_key(one.name): one for one in arguments if one.parse and not one.children}
        named = leaves["config"].tokens
        leaves = {key: one for key, one in leaves.items() if key not in COMMON}
        file = Path(named[0].value) if named else self._file
        said = {} if file is None else self._in_file(file, leaves)
        for key, (value, place) in (said | self._in_environment(leaves)).items():
            argument = leaves[key]
            if argument.tokens:
                continue
            is_list = typing.get_origin(argument.hint) is tuple and not argument.parameter.n_tokens
            if is_list and isinstance(value, str):
                value = [item.strip() for item in value.split(",") if item.strip()]
            for index, item in enumerate(value if isinstance(value, list) else [value]):
                text = str(item).lower() if isinstance(item, bool) else str(item)
                argument.append(Token(keyword=place, value=text, index=index))

    def _in_environment(self, leaves: Mapping[str, Argument]) -> dict[str, tuple[str, str]]:
        """Value and place by key; an empty variable is not set."""
        prefix = f"PICA_{_upper(self._name)}_"
        variables = {f"PICA_{_upper(key)}": key for key in self._shared if key in leaves}
        variables |= {prefix + _upper(key): key for key in leaves}
        shared = {f"PICA_{_upper(key)}" for key in SHARED}  # not options of `pica token`
        for variable in sorted(self._environment):
            if variable.startswith(prefix) and variable not in {*variables, *shared}:
                raise UsageError(
                    f"unknown environment variable {variable}{_near(variable, variables)}"
                )
        return {
            key: (text, variable)
            for variable, key in variables.items()
            if (text := self._environment.get(variable))
        }

    def _in_file(self, file: Path, leaves: Mapping[str, Argument]) -> dict[str, tuple[Any, str]]:
        """Value and place by key, from the shared keys of the file and the command's own table."""
        document = _read_toml(file)
        families = {name.partition(" ")[0] for name in COMMANDS}
        for key, value in document.items():
            if key not in (families if isinstance(value, dict) else SHARED):
                raise UsageError(f"{file}: unknown key {key}{_near(key, (*SHARED, *families))}")
        own: Any = document
        for word in self._name.split():
            own = own.get(word, {}) if isinstance(own, dict) else {}
        found = {key: document[key] for key in self._shared if key in document and key in leaves}
        table = ".".join(self._name.split())
        for key, value in _flat(own):
            if key not in leaves:
                raise UsageError(f"{file}: unknown key {table}.{key}{_near(key, leaves)}")
            found[key] = value
        for key, value in found.items():
            if Path in (leaves[key].hint, *typing.get_args(leaves[key].hint)):
                found[key] = file.parent / Path(str(value)).expanduser()
        return {key: (value, f"{file}: {key}") for key, value in found.items()}


def _taker(function: Any) -> Callable[..., None]:
    """A signature with the parameters of a command, and with options that all commands take.

    Fields of the command's dataclasses become flags without a prefix.
    """
    either, flag = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    parameters = []
    for name, kind in typing.get_type_hints(function, include_extras=True).items():
        if name != "return":
            flat: Any = Annotated[kind, Parameter(name="*")]
            required = any(
                each.default is MISSING and each.default_factory is MISSING for each in fields(kind)
            )
            default = inspect.Parameter.empty if required else kind()
            parameters.append(inspect.Parameter(name, either, annotation=flat, default=default))
    for name, (kind, default, text) in COMMON.items():
        rule = Parameter(group=_GROUP, negative=(), show_default=False, help=text)
        parameters.append(
            inspect.Parameter(name, flag, annotation=Annotated[kind, rule], default=default)
        )

    def take(**given: Any) -> None:
        raise AssertionError("its signature alone is used")

    take.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    take.__annotations__ = {each.name: each.annotation for each in parameters}
    return take


def _description(function: Any) -> str:
    """What of a function's docstring is meant for users of its command."""
    docstring = inspect.getdoc(function) or ""
    return _SECTION.split(docstring, maxsplit=1)[0].strip().replace("``", "`")


def _read_toml(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise UsageError(f"{file}: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(f"{file} is not a TOML file: {error}") from error


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def _key(flag: str) -> str:
    """The key of an option in a file."""
    return flag.removeprefix("--").replace("-", "_")


def _upper(name: str) -> str:
    return re.sub(r"[ .]", "_", name).upper()


def _near(name: str, known: Iterable[str]) -> str:
    near = get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"; did you mean {near[0]}?" if near else ""


def install_completion(words: Sequence[str]) -> None:
    """Write a script that completes commands and options where the user's shell looks for it.

    Options of a command whose extra is missing are left out.

    Args:
        words: The flag, and what follows it: ``--shell``, ``--output``.
    """
    root = App(name="pica", version_flags=(), result_action="return_value")
    for name, row in COMMANDS.items():
        first, _, last = name.partition(" ")
        try:
            app = CommandLine(name, row, {}, None).app
        except ModuleNotFoundError:
            continue
        if last and first not in root:
            root.command(App(name=first))
        (root[first] if last else root).command(app, name=last or first)
    root.register_install_completion_command(words[0])
    root(words)
