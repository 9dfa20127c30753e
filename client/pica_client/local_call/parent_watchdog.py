"""Run a `pica` command that ends with its parent.

Called as ``python -m pica_client.local_call.parent_watchdog COMMAND …``.

A demo or bench starts relay, senders and receiver as processes of their own. Each reads its
standard input, a pipe that the parent holds open and never writes to: when the parent ends, in
whatever way, the pipe ends too. That is portable, and holds even for a parent that was killed.
"""

import os
import runpy
import signal
import sys
import threading
import time

GRACE_S = 3.0
"""Time between being asked to end and being ended; no command needs longer to say goodbye."""


def main() -> None:
    """Watch the parent and become the command."""
    threading.Thread(target=_follow_parent, name="parent-watchdog", daemon=True).start()
    sys.argv[0] = "pica"
    runpy.run_module("pica_command", run_name="__main__", alter_sys=False)


def _follow_parent() -> None:
    try:
        while os.read(0, 4096):
            pass
    except OSError:
        pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(GRACE_S)
    os._exit(1)


if __name__ == "__main__":
    main()
