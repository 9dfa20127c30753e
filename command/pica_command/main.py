"""One command whose sub-commands are entry points, each loaded only when it is called.

An entry point of the group ``pica.commands`` names a function with one parameter, a frozen
dataclass of options, that returns a map or None. The name's dots stand for spaces: ``bench.call``
is ``pica bench call``. So the relay starts without importing numpy, and an extension adds a
sub-command by being installed. Options that come from elsewhere too, as from a file, bring a class
method ``parse(words, *, prog, description)`` that makes them.

Exit status: 0 done; 2 bad usage or bad input (any exception with an ``exit_code``, or a missing
extra); 1 a failure, or a result whose ``ok`` is false.
"""

import inspect
import json
import re
import sys
import traceback
import typing
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.metadata import EntryPoint, entry_points, metadata, requires, version

DISTRIBUTION = "pica-telepresence"
COMMAND_GROUP = "pica.commands"
DEBUG_FLAG = "--debug"

_MODULE_OF_DISTRIBUTION = {"pillow": "PIL"}
"""Where the name to import differs from the name to install."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command and return its exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    commands = {entry.name: entry for entry in entry_points(group=COMMAND_GROUP)}
    name, rest = _split(arguments, commands)
    if name is None:
        return _explain(arguments, commands)
    as_json = "--json" in rest
    debug = DEBUG_FLAG in rest
    rest = [word for word in rest if word not in ("--json", DEBUG_FLAG)]
    spoken = f"pica {name.replace('.', ' ')}"
    try:
        result = _run(commands[name], spoken, rest)
    except KeyboardInterrupt:
        print(f"{spoken}: stopped", file=sys.stderr)
        return 130
    except ModuleNotFoundError as error:
        extra = _extra_with(error.name or "")
        if extra is None or debug:
            raise
        print(
            f"{spoken}: needs {error.name}; install it with: pip install '{DISTRIBUTION}[{extra}]'",
            file=sys.stderr,
        )
        return 2
    except Exception as error:
        code = getattr(error, "exit_code", None)
        if code is None and isinstance(error, OSError) and error.filename is not None:
            code = 2
        if code is None or debug:
            traceback.print_exc()
            return 1
        print(f"{spoken}: {' '.join(str(error).split())}", file=sys.stderr)
        return int(code)
    if as_json:
        print(json.dumps(result if result is not None else {}), flush=True)
    return 0 if result is None or result.get("ok", True) else 1


def _split(
    arguments: list[str], commands: Mapping[str, EntryPoint]
) -> tuple[str | None, list[str]]:
    """The longest command that the first words spell, and the words after it."""
    for count in (2, 1):
        name = ".".join(arguments[:count])
        if len(arguments) >= count and name in commands:
            return name, arguments[count:]
    return None, arguments


def _run(entry: EntryPoint, spoken: str, rest: list[str]) -> Mapping[str, typing.Any] | None:
    function = entry.load()
    (parameter,) = inspect.signature(function).parameters
    options_type = typing.get_type_hints(function)[parameter]
    description = (inspect.getdoc(function) or "") + (
        "\n\nWith --json the last line of stdout is the result as one JSON object; "
        f"{DEBUG_FLAG} shows the traceback of an error."
    )
    parse = getattr(options_type, "parse", None)
    if parse is not None:
        options = parse(rest, prog=spoken, description=description)
    else:
        import tyro  # half of a command's start; --version and the list do without

        options = tyro.cli(options_type, prog=spoken, args=rest, description=description)
    result: Mapping[str, typing.Any] | None = function(options)
    return result


def _explain(arguments: list[str], commands: Mapping[str, EntryPoint]) -> int:
    """Say which sub-commands there are; an unknown one is bad usage."""
    if arguments[:1] == ["--version"]:
        print(version(DISTRIBUTION))
        return 0
    asked_for_help = not arguments or arguments[0] in ("-h", "--help")
    group = sorted(name for name in commands if arguments and name.startswith(f"{arguments[0]}."))
    out = sys.stdout if asked_for_help else sys.stderr
    if not asked_for_help and not group:
        print(f"pica: no command {arguments[0]!r}", file=out)
    print(
        f"{metadata(DISTRIBUTION)['Summary']}\n\nusage: pica COMMAND [OPTIONS] [--json]\n", file=out
    )
    for name in group or sorted(commands):
        print(f"  pica {name.replace('.', ' ')}", file=out)
    print("\n`pica COMMAND --help` explains one of them.", file=out)
    return 0 if asked_for_help else 2


def _extra_with(module: str) -> str | None:
    """The smallest extra that brings the top-level `module`, by our own metadata; None if none."""
    top = module.partition(".")[0]
    sizes: Counter[str] = Counter()
    bringing: set[str] = set()
    for line in requires(DISTRIBUTION) or ():
        requirement, _, marker = line.partition(";")
        if "extra ==" not in marker:
            continue
        extra = marker.split("extra ==")[1].strip().strip("'\"")
        sizes[extra] += 1
        name = re.split(r"[\[<>=!~ ]", requirement.strip(), maxsplit=1)[0]
        if _MODULE_OF_DISTRIBUTION.get(name, name.replace("-", "_")) == top:
            bringing.add(extra)
    return min(bringing, key=lambda extra: (sizes[extra], extra), default=None)
