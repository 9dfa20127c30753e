"""Options of a command from its words, the environment and a TOML file, as cyclopts reads them.

    flags  >  environment  >  file  >  defaults

A command's options are a frozen dataclass. The option ``--limits.joins-per-s`` of ``pica relay`` is
the variable ``PICA_RELAY_LIMITS_JOINS_PER_S`` and the key ``joins_per_s`` of the table
``[relay.limits]``. The file is the user's, or the one that ``--config`` or ``PICA_CONFIG`` names.
Commands that join a room share a few options: ``PICA_URL``, and ``url`` above all tables.
"""

import codecs
import inspect
import os
import re
import tomllib
import typing
from collections.abc import Callable, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import App, ArgumentCollection, CycloptsError, Group, Parameter
from cyclopts.config import Dict, Env

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
    """One command with its options.

    Args:
        name: Its words.
        row: Its row of the table; its module is imported here.
        file: The file of options, if no flag names another; None if there is none.
    """

    def __init__(self, name: str, row: Command, file: Path | None) -> None:
        self.function = row.load()
        self._name = name
        self._joins = row.joins
        self._file = file
        prefix = self._prefix = f"PICA_{_upper(name)}_"
        shared = [Env("PICA_", command=False, show=False)] if row.joins else []
        self.app = App(
            name=f"pica {name}",
            help=_description(self.function),
            help_format="markdown",
            group_commands=_GROUP,
            help_flags=("--help", "-h"),
            version_flags=(),
            default_parameter=Parameter(consume_multiple=True, negative_iterable=()),
            config=[self._know, Env(prefix, command=False, show=False), *shared, self._add_file],
        )
        self._take = _taker(self.function)
        self.app.default(self._take)

    def read(self, words: Sequence[str]) -> dict[str, Any] | None:
        """Read the options: the arguments for the function; None after help was printed.

        Raises:
            UsageError: A word, variable or key is unknown, or a value is refused; names it.
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

    def _know(self, _: App, commands: tuple[str, ...], arguments: ArgumentCollection) -> None:
        """Refuse variables of the command that mean no option: a relay whose key is misspelt would
        let everybody in."""
        names = [f"{self._prefix}{_upper(one.name.lstrip('-'))}" for one in arguments]
        known = {*names, *(f"PICA_{_upper(key)}" for key in SHARED)}
        for variable in sorted(os.environ.keys() - known):
            if variable.startswith(self._prefix):
                raise UsageError(f"unknown environment variable {variable}")

    def _add_file(self, app: App, commands: tuple[str, ...], arguments: ArgumentCollection) -> None:
        """Add what the file says of arguments that neither a flag nor a variable sets."""
        config = next(one.tokens for one in arguments if one.name == "--config")
        named = [Path(token.value) for token in config if token.source != "env"]
        file = named[0] if named else self._file
        if file is None:
            return
        document = _read_toml(file)
        known = {*SHARED, *(name.partition(" ")[0] for name in COMMANDS)}
        if unknown := document.keys() - known:
            raise UsageError(f"{file}: unknown key {min(unknown)}")
        shared: dict[str, Any] = {
            key: document[key] for key in SHARED if key in document and self._joins
        }
        for data, keys in ((document, self._name.split()), (shared, [])):
            source = Dict(data=data, root_keys=keys, use_commands_as_keys=False, source=str(file))
            source.allow_unknown = not keys
            source(app, commands, arguments)
        for argument in arguments:
            if Path in (argument.hint, *typing.get_args(argument.hint)):
                argument.tokens[:] = [
                    token.evolve(value=str(file.parent / Path(token.value).expanduser()))
                    if token.source == str(file)
                    else token
                    for token in argument.tokens
                ]


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


def _upper(name: str) -> str:
    """A command or an option as variables name it."""
    return re.sub(r"[ .-]", "_", name).upper()


def _description(function: Any) -> str:
    """What of a function's docstring is meant for users of its command."""
    docstring = inspect.getdoc(function) or ""
    return _SECTION.split(docstring, maxsplit=1)[0].strip().replace("``", "`")


def _read_toml(file: Path) -> dict[str, Any]:
    try:
        content = file.read_bytes()
        is_utf_16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))  # PowerShell's
        return tomllib.loads(content.decode("utf-16" if is_utf_16 else "utf-8-sig"))
    except OSError as error:
        raise UsageError(f"{file}: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(f"{file} is not a TOML file: {error}") from error
