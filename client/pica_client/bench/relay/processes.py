"""The processes of a relay bench: servers and load, each on its core, and what they cost."""

import json
import os
import select
import subprocess
import urllib.error
import urllib.request
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from pica_client.errors import CallProcessError, OptionError
from pica_client.local_call.processes import ChildProcess, end_all

START_TIMEOUT_S = 20.0
"""Seconds that a process has to say its first word."""
STOP_TIMEOUT_S = 5.0
"""Seconds that all processes together have to end when asked; then they are killed."""


class Worker(ChildProcess):
    """A process that is spoken to over its standard input and output."""

    def __init__(self, name: str, words: Sequence[str], core: int | None = None) -> None:
        super().__init__(name, words, stdout=subprocess.PIPE)
        pin(self.pid, core)

    def order(self, line: str) -> None:
        """Send a line.

        Raises:
            CallProcessError: It has ended.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(f"{line}\n".encode())
            self._process.stdin.flush()
        except OSError as error:
            raise self._failure() from error

    def answer(self, timeout_s: float) -> dict[str, Any]:
        """Wait for a JSON object.

        Raises:
            CallProcessError: It has ended, or prints nothing.
            OptionError: It refuses its configuration.
        """
        answer = json.loads(self.line(timeout_s))
        if "error" in answer:
            raise OptionError(answer["error"])
        return dict(answer)

    def line(self, timeout_s: float) -> str:
        """Wait for a line of its output.

        Raises:
            CallProcessError: It has ended, or prints nothing.
        """
        assert self._process.stdout is not None
        ready, _, _ = select.select([self._process.stdout], [], [], timeout_s)
        line = self._process.stdout.readline() if ready else b""
        if not line.endswith(b"\n"):
            raise self._failure()
        return line.decode().strip()

    def wait(self, deadline: float) -> None:
        """Wait for its end until `deadline` (`time.monotonic`), then kill it."""
        super().wait(deadline)
        assert self._process.stdout is not None
        self._process.stdout.close()

    def _failure(self) -> CallProcessError:
        code = self.exit_code
        how = "prints nothing" if code is None else f"ended with status {code}"
        return CallProcessError(f"{self.name} {how}")


class Workers:
    """A group of workers; leaving the ``with`` block ends all of them."""

    def __init__(self) -> None:
        self._workers: list[Worker] = []

    def start(self, program: str | Path, *arguments: str, core: int | None = None) -> Worker:
        """Start a module of this package, by its name, or a file."""
        is_file = isinstance(program, Path)
        words = (str(program),) if is_file else ("-P", "-m", f"pica_client.bench.relay.{program}")
        worker = Worker(Path(program).stem, (*words, *arguments), core)
        self._workers.append(worker)
        return worker

    def stop(self, workers: Iterable[Worker]) -> None:
        """End some of them."""
        ending = list(workers)
        end_all(ending, STOP_TIMEOUT_S)
        for worker in ending:
            self._workers.remove(worker)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop(self._workers)


def share_cores() -> tuple[int | None, int | None]:
    """Choose a core for the server and one for the load; None where nothing can be pinned."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    return (cores[-1], cores[0]) if len(cores) > 1 else (None, None)


def pin(pid: int, core: int | None) -> None:
    """Let a process run on one core."""
    if core is not None:
        os.sched_setaffinity(pid, {core})


def cpu_s(pid: int) -> float | None:
    """Processor time that a process has used, of user and system; None where that is not told."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_bytes(pid: int, field: str = "VmRSS") -> int | None:
    """Resident memory of a process, or with "VmHWM" its peak; None where that is not told."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return None
    for line in lines:
        name, _, value = line.partition(":")
        if name == field:
            return int(value.split()[0]) * 1024
    return None


def relay_metrics(url: str) -> dict[str, float]:
    """What the relay itself counts, by Prometheus name and labels; empty if it does not tell us."""
    page = url.replace("ws", "http", 1).rstrip("/") + "/metrics"
    try:
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(page, timeout=5.0) as response:
            text = response.read(1 << 20).decode()
    except (OSError, ValueError):
        return {}
    values = {}
    for line in text.splitlines():
        name, _, value = line.rpartition(" ")
        if name and not line.startswith("#"):
            values[name] = float(value)
    return values


def summed(metrics: Mapping[str, float], name: str) -> float:
    """Return the sum of a family over its labels."""
    return sum(
        value for key, value in metrics.items() if key == name or key.startswith(f"{name}{{")
    )
