"""The `pica` command: finds a sub-command in the table, loads it alone, and reports how it ended.

Exit status: 0 done; 2 bad usage or bad input (any exception with an ``exit_code``, or a missing
extra); 1 a failure, a result whose ``ok`` is false, or no room for the output; 130 stopped by
Ctrl-C; 141 the reader of the output has gone, as after ``| head``.
"""

import errno
import json
import os
import re
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from pica_command.table import (
    COMMANDS,
    DISTRIBUTION,
    command_of,
    extra_with,
    install_line,
    listing,
    refuse,
)

DEBUG_FLAG: Final = "--debug"
JSON_FLAG: Final = "--json"
CONFIG_VARIABLE: Final = "PICA_CONFIG"
"""Names another file than the user's."""
UNWRITTEN: Final = (errno.EPIPE, errno.ENOSPC)
"""The errors of output that has no reader any more, or no room."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command and return its exit status."""
    try:
        status = _run_and_report(list(sys.argv[1:] if argv is None else argv))
        sys.stdout.flush()
    except OSError as error:  # the rest of the output goes nowhere, so that no flush complains
        is_unread = isinstance(error, BrokenPipeError)
        for stream in (sys.stdout, sys.stderr) if is_unread else (sys.stdout,):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        if not is_unread:
            print(f"pica: the output cannot be written: {error.strerror}", file=sys.stderr)
        return 141 if is_unread else 1
    return status


def _run_and_report(words: list[str]) -> int:
    name = command_of(words)
    try:
        if name is None:
            return _explain(words)
        result = _run(name, words[len(name.split()) :])
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    except (Exception, KeyboardInterrupt) as error:
        if isinstance(error, OSError) and error.errno in UNWRITTEN and error.filename is None:
            raise
        return _report(error, name, words)
    if JSON_FLAG in words and result is not None:
        print(json.dumps(result), flush=True)
    return 0 if result is None or result.get("ok", True) else 1


def _run(name: str, words: list[str]) -> Mapping[str, Any] | None:
    """Run a command; None after its help was printed."""
    with _nothing_begun():
        from pica_command.options import CommandLine  # the list of commands does without cyclopts

        for variable, text in list(os.environ.items()):
            if variable.startswith("PICA_") and not text:
                del os.environ[variable]  # an empty one is not set
        file = user_file()
        has_file = CONFIG_VARIABLE in os.environ or file.exists()
        line = CommandLine(name, COMMANDS[name], file if has_file else None)
        options = line.read(words)
    if options is None:
        return None
    result: Mapping[str, Any] | None = line.function(**options)
    return {} if result is None else result


def user_file() -> Path:
    """The TOML file of this user's options; it need not be there."""
    from platformdirs import PlatformDirs  # until here a signal ends the process as it would any

    folder = PlatformDirs(DISTRIBUTION, appauthor=False, roaming=True).user_config_path
    return Path(os.environ.get(CONFIG_VARIABLE) or folder / "pica.toml")


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


def _report(error: BaseException, name: str | None, words: list[str]) -> int:
    """Print what went wrong in one line, with ``--json`` as an object too; return the status."""
    kind, message, code, more = _describe(error, () if name is None else COMMANDS[name].extras)
    title = f"pica {name or ''}".strip()
    if DEBUG_FLAG in words or kind == "bug":
        traceback.print_exception(error)
    if kind != "bug":
        shown = "".join(char if char.isprintable() or char == "\n" else " " for char in message)
        print(f"{title}: {shown}", file=sys.stderr)
    if JSON_FLAG in words:
        described = {"kind": kind, "message": message, "command": title, "exit_code": code}
        print(json.dumps({"error": described | more}), flush=True)
    return code


def _describe(error: BaseException, extras: Sequence[str]) -> tuple[str, str, int, dict[str, Any]]:
    """Kind, message, exit status and further fields of an error."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted", "stopped", 130, {}
    missing = error.name or "" if isinstance(error, ModuleNotFoundError) else ""
    if missing and (extra := extra_with(missing, extras)):
        fix = install_line(extra)
        message = f"needs {missing}; install it with: {fix}"
        return "missing_extra", message, 2, {"extra": extra, "install": fix}
    message = " ".join(str(error).split())
    code = getattr(error, "exit_code", None)
    if code is None and isinstance(error, OSError) and error.filename is not None:
        code = 2
    if code is None:
        return "bug", message or type(error).__name__, 1, {"type": type(error).__name__}
    name = type(error).__name__.removesuffix("Error")
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower(), message, int(code), {}


def _explain(words: list[str]) -> int:
    """List the commands; words that begin none are bad usage, as `refuse` says."""
    if words[:1] == ["--version"]:
        from importlib.metadata import version

        print(version(DISTRIBUTION))
        return 0
    family = words[0] if words and any(name.startswith(f"{words[0]} ") for name in COMMANDS) else ""
    if not [word for word in words[bool(family) :] if word not in ("-h", "--help")]:
        is_half_a_command = len(words) == 1 and bool(family)
        print(
            f"{listing(family)}\n\n`pica COMMAND --help` explains one of them.\n"
            f"Options may also stand in {user_file()}.",
            file=sys.stderr if is_half_a_command else sys.stdout,
        )
        return 2 if is_half_a_command else 0
    refuse(words)
