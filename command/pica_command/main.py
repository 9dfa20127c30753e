"""One command whose sub-commands are entry points, each loaded only when it is called.

An entry point of the group ``pica.commands`` names a function with one parameter, a frozen
dataclass of options, that returns a map or None. The name's dots stand for spaces: ``bench.call``
is ``pica bench call``; the extras of the entry point are what the command needs. So the relay
starts without importing numpy, and an extension adds a sub-command by being installed. Variables
and a file may set options, too: see `pica_command.profile`.

Exit status: 0 done; 2 bad usage or bad input (any exception with an ``exit_code``, or a missing
extra); 1 a failure, or a result whose ``ok`` is false; 130 stopped by Ctrl-C; 141 nobody reads
what it prints any more, as after ``| head``. ``--debug`` shows tracebacks and changes none of
these.
"""

import inspect
import json
import os
import re
import select
import signal
import sys
import threading
import traceback
import typing
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import EntryPoint, version

from pica_command.catalogue import commands, listing, nearest, options_type_of, spoken
from pica_command.errors import UsageError
from pica_command.extras import DISTRIBUTION, extra_with, install_line
from pica_command.parsing import description_of, parse_words
from pica_command.profile import read_command
from pica_command.settings import as_plain, as_toml, naming_places

DEBUG_FLAG = "--debug"
JSON_FLAG = "--json"
PRINT_FLAG = "--print-config"
COMMON_HELP = (
    f"With {JSON_FLAG} the last line of stdout is the result, or the error, as one JSON object; "
    f"{DEBUG_FLAG} shows the traceback of an error; {PRINT_FLAG} prints all options, each with "
    "where it comes from, and stops."
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command and return its exit status."""
    try:
        status = _run_and_report(argv)
        sys.stdout.flush()
    except BrokenPipeError:
        if not _is_unread():
            raise
        return 141
    return status


def _is_unread() -> bool:
    """Say whether whoever read our output has gone; if so, the rest of it goes nowhere."""
    if not hasattr(select, "poll"):
        return False  # Windows, where this is another error
    poll = select.poll()
    for stream in (sys.stdout, sys.stderr):
        poll.register(stream.fileno(), 0)
    unread = [number for number, event in poll.poll(0) if event & select.POLLERR]
    for number in unread:
        os.dup2(os.open(os.devnull, os.O_WRONLY), number)
    return bool(unread)


def _run_and_report(argv: Sequence[str] | None) -> int:
    arguments = list(sys.argv[1:] if argv is None else argv)
    flags = {flag for flag in (DEBUG_FLAG, JSON_FLAG, PRINT_FLAG) if flag in arguments}
    words = [word for word in arguments if word not in flags]
    known = commands()
    name, rest = _split(words, known)
    title = "pica" if name is None else spoken(name)
    try:
        if name is None:
            return _explain(words, known)
        result = _run(name, known[name], rest, flags)
    except SystemExit as end:  # --help
        return end.code if isinstance(end.code, int) else 0
    except (Exception, KeyboardInterrupt) as error:
        if isinstance(error, BrokenPipeError) and _is_unread():
            return 141
        return _report(error, title, () if name is None else known[name].extras, flags)
    if JSON_FLAG in flags:
        print(json.dumps(result if result is not None else {}), flush=True)
    return 0 if result is None or result.get("ok", True) else 1


def _split(arguments: list[str], known: Mapping[str, EntryPoint]) -> tuple[str | None, list[str]]:
    """The longest command that the first words spell, and the words after it."""
    for count in (2, 1):
        name = ".".join(arguments[:count])
        if len(arguments) >= count and name in known:
            return name, arguments[count:]
    return None, arguments


def _run(
    name: str, entry: EntryPoint, rest: list[str], flags: typing.Collection[str]
) -> Mapping[str, typing.Any] | None:
    with _nothing_begun():
        function = entry.load()
        options_type = options_type_of(entry)
        description = f"{description_of(inspect.getdoc(function) or '')}\n\n{COMMON_HELP}"
        if getattr(options_type, "OWN_FILE", False):
            description += " --config FILE reads options from a TOML file."

        def parse(words: Sequence[str]) -> typing.Any:
            return parse_words(options_type, words, prog=spoken(name), description=description)

        options, effective = read_command(name, options_type, rest, os.environ, parse)
    if PRINT_FLAG in flags:
        table = "" if getattr(options_type, "OWN_FILE", False) else name
        print(as_toml(effective, table), end="")
        return as_plain(effective)
    with naming_places(effective):
        result: Mapping[str, typing.Any] | None = function(options)
    return result


@contextmanager
def _nothing_begun() -> Iterator[None]:
    """Let SIGTERM end the command in good order while the block runs: loading takes a while."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _report(
    error: BaseException, title: str, extras: Sequence[str], flags: typing.Collection[str]
) -> int:
    """Say what went wrong in one line, with ``--json`` as an object too; return the status."""
    kind, message, code, more = _what_of(error, extras)
    if DEBUG_FLAG in flags or kind == "bug":
        traceback.print_exception(error)
    if kind != "bug":
        print(f"{title}: {message}", file=sys.stderr)
    if JSON_FLAG in flags:
        described = {"kind": kind, "message": message, "command": title, "exit_code": code}
        print(json.dumps({"error": described | more}), flush=True)
    return code


def _what_of(
    error: BaseException, extras: Sequence[str]
) -> tuple[str, str, int, dict[str, typing.Any]]:
    """Kind, message, exit status and further fields of an error."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted", "stopped", 130, {}
    if isinstance(error, ModuleNotFoundError):
        extra = extra_with(error.name or "", extras)
        if extra is not None:
            fix = install_line(extra)
            message = f"needs {error.name}; install it with: {fix}"
            return "missing_extra", message, 2, {"extra": extra, "install": fix}
    message = " ".join(str(error).split())
    code = getattr(error, "exit_code", None)
    if code is None and isinstance(error, OSError) and error.filename is not None:
        code = 2
    if code is None:
        return "bug", message or type(error).__name__, 1, {"type": type(error).__name__}
    if isinstance(error, UsageError):
        return "usage", message, int(code), {}
    name = type(error).__name__.removesuffix("Error")
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower(), message, int(code), {}


def _explain(words: list[str], known: Mapping[str, EntryPoint]) -> int:
    """Say which sub-commands there are; an unknown one is bad usage.

    Raises:
        UsageError: No command begins so.
    """
    if words[:1] == ["--version"]:
        print(version(DISTRIBUTION))
        return 0
    family = words[0] if words and any(name.startswith(f"{words[0]}.") for name in known) else ""
    if not [word for word in words[bool(family) :] if word not in ("-h", "--help")]:
        is_half_a_command = len(words) == 1 and bool(family)
        print(listing(known, family), file=sys.stderr if is_half_a_command else sys.stdout)
        return 2 if is_half_a_command else 0
    near = nearest(words, known)
    hint = f"did you mean `pica {near}`?" if near else "`pica --help` lists all commands"
    raise UsageError(f"no command {' '.join(words[:2] if family else words[:1])!r}; {hint}")
