"""The processes of a demo or bench: started together, watched, and ended together in bounded
time.

Each reads its standard input, a pipe that the parent holds open and never writes to: when the
parent ends, in whatever way, the pipe ends too, and `main` ends the command. That is portable, and
holds even for a parent that was killed.
"""

import contextlib
import json
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Self

from pica_client.errors import CallProcessError

MODULE = "pica_client.local_call.processes"
GRACE_S = 3.0
"""Time between being asked to end and being ended; no command needs longer."""
START_TIMEOUT_S = 20.0
"""Longest wait for a relay to say where it listens; importing numpy can take seconds."""
STOP_TIMEOUT_S = 6.0
"""For all processes together to end when asked; more than `GRACE_S`. Then they are
killed."""


class Child:
    """One `pica` command in a process of its own, which ends when its standard input does.

    It is run with `-P`: nothing is imported from whatever folder the user is in.
    """

    def __init__(self, name: str, arguments: Sequence[str], folder: Path) -> None:
        self.name = name
        self._out, self._err = folder / f"{name}.out", folder / f"{name}.err"
        # Without what our user set for commands of their own.
        bare = {name: value for name, value in os.environ.items() if not name.startswith("PICA_")}
        bare["PICA_CONFIG"] = os.devnull
        with self._out.open("wb") as out, self._err.open("wb") as err:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", MODULE, *arguments, "--json"],
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=err,
                env=bare,
                # Ctrl-C in a terminal goes to the parent, which ends its children in good order.
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """How it ended, or None while it runs."""
        return self._process.poll()

    def let_go(self) -> None:
        """Ask it to end, by closing the pipe that it watches."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()

    def wait(self, deadline: float) -> None:
        """Wait for its end until `deadline` (`time.monotonic`), then kill it."""
        try:
            self._process.wait(max(deadline - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def result(self) -> dict[str, Any]:
        """What it printed as its result.

        Raises:
            CallProcessError: It failed, or printed none.
        """
        if self.exit_code:
            self.check()
        lines = self._out.read_text(errors="replace").splitlines()
        try:
            result = json.loads(lines[-1]) if lines else None
        except json.JSONDecodeError:
            result = None
        if not isinstance(result, dict):
            raise CallProcessError(f"{self.name} gave no result; it said: {self.last_words()}")
        return result

    def check(self) -> None:
        """Raise if it has ended."""
        code = self.exit_code
        if code is not None:
            how = f"was killed by signal {-code}" if code < 0 else f"ended with status {code}"
            raise CallProcessError(
                f"{self.name} {how}: {self.last_words()}", exit_code=2 if code == 2 else 1
            )

    def last_words(self) -> str:
        """The last line of its stderr."""
        lines = self._err.read_text(errors="replace").strip().splitlines()
        return lines[-1].strip()[:300] if lines else "nothing"


def end_all(children: Iterable[Child], timeout_s: float) -> None:
    """Ask processes to end, wait, and kill those that did not in time."""
    ending = list(children)
    for child in ending:
        child.let_go()
    deadline = time.monotonic() + timeout_s
    for child in ending:
        child.wait(deadline)


class Children:
    """A group of child processes; leaving the ``with`` block ends all of them.

    Attributes:
        folder: Lives as long as the group.
    """

    def __init__(self) -> None:
        self._children: list[Child] = []
        self._temporary = tempfile.TemporaryDirectory(prefix="pica-")
        self.folder = Path(self._temporary.name)

    def start(self, name: str, *arguments: str) -> Child:
        """Start ``pica ARGUMENTS``."""
        child = Child(name, arguments, self.folder)
        self._children.append(child)
        return child

    def start_relay(self, *arguments: str) -> tuple[Child, str]:
        """Start ``pica relay ARGUMENTS`` on a free port and wait until it listens.

        Returns:
            The process and its address.

        Raises:
            CallProcessError: It ended, or did not listen in time.
        """
        ready = self.folder / "relay.url"
        relay = self.start("relay", "relay", "--port", "0", "--ready-file", str(ready), *arguments)
        deadline = time.monotonic() + START_TIMEOUT_S
        while not ready.exists():
            relay.check()
            if time.monotonic() > deadline:
                raise CallProcessError(f"relay did not start: {relay.last_words()}")
            time.sleep(0.02)
        return relay, ready.read_text().strip()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        end_all(self._children, STOP_TIMEOUT_S)
        self._temporary.cleanup()


def main() -> None:
    """Run a `pica` command that ends with its parent, as ``python -m … COMMAND``."""
    threading.Thread(target=_follow_parent, name="parent-watchdog", daemon=True).start()
    sys.argv[0] = "pica"
    runpy.run_module("pica_command", run_name="__main__", alter_sys=False)


def _follow_parent() -> None:
    with contextlib.suppress(OSError):
        while os.read(0, 4096):
            pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(GRACE_S)
    os._exit(1)


if __name__ == "__main__":
    main()
