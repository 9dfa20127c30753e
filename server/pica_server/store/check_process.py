"""The check that receivers make, run by the relay on an upload: in a process of its own.

The relay imports neither numpy nor what reads avatars. Where both are installed beside it, ``pica
avatar verify`` looks at a file that came in, in another process with little time and memory, at low
priority and without the relay's environment: it may hold passwords, and the file is a stranger's.

``python -m pica_server.store.check_process FILE`` sets those limits for itself and becomes that
command.
"""

import importlib.util
import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Final

from pica_server.errors import StoreError, UnfitFileError

LONGEST_S: Final = 20.0
"""Seconds of processor time, twice that by the clock; 64 MiB, the largest, take about one."""
MOST_MEMORY_BYTES: Final = 2 * 2**30
"""Address space for the libraries, and for a file of 64 MiB in float32 some times over."""
NICENESS: Final = 10
_NEEDED: Final = ("numpy", "safetensors")
_PASSED_ON: Final = ("PATH", "SYSTEMROOT", "LANG", "LC_ALL", "TMPDIR", "TEMP", "TMP")


def is_installed() -> bool:
    """Say whether the full check can be run here; imports nothing."""
    try:
        return all(importlib.util.find_spec(name) is not None for name in _NEEDED)
    except ImportError:
        return False


def check_fully(path: Path, identity: str) -> None:
    """Run ``pica avatar verify`` on a file; blocks.

    Raises:
        UnfitFileError: A receiver would refuse it.
        StoreError: The check itself could not be run to its end.
    """
    command = [sys.executable, "-I", "-m", "pica_server.store.check_process", str(path), identity]
    environment = {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
    # Each thread of theirs would take address space, and a core.
    environment |= {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=2 * LONGEST_S,
            env=environment,
        )
    except subprocess.TimeoutExpired as error:
        raise UnfitFileError("the check took too long") from error
    except OSError as error:
        raise StoreError("the check could not be started") from error
    last_words = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
    if done.returncode == 0 and _says_ok(done.stdout, identity):
        return
    if done.returncode == 2 and last_words.startswith("pica avatar verify:"):
        # It names the file by a path that the uploader must not learn.
        raise UnfitFileError(last_words.partition(f"{path}:")[2].strip() or "not an avatar file")
    if done.returncode < 0:
        raise UnfitFileError("the check took too much time or memory")
    raise StoreError(f"the check ended with status {done.returncode}")


def _says_ok(stdout: bytes, identity: str) -> bool:
    try:
        result = json.loads(stdout.strip().rpartition(b"\n")[2])
    except ValueError:
        return False
    return isinstance(result, dict) and result.get("ok") is True and result["sha256"] == identity


def _become_the_check(path: str, identity: str) -> None:
    with suppress(ImportError, OSError, ValueError, AttributeError):  # not on every system
        import resource

        seconds = round(LONGEST_S)
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY_BYTES, MOST_MEMORY_BYTES))
        os.nice(NICENESS)
    words = ["avatar", "verify", path, "--sha256", identity, "--json"]
    os.execv(sys.executable, [sys.executable, "-I", "-m", "pica_command", *words])


if __name__ == "__main__":
    _become_the_check(*sys.argv[1:])
