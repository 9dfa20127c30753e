"""The network half of a receiver: runs a link and feeds a call with what comes over it.

Garbage never gets further than here: what breaks the protocol ends the connection, is counted, and
the link comes back; what breaks a payload is counted by the call.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
import threading
from types import TracebackType
from typing import Any, Self

from pica_client.call import Call
from pica_client.link import Connector, Link, LinkConfig
from pica_protocol.session import ClientEvent

REPORT_INTERVAL_S = 5.0
"""Between two reports to the relay."""
JOIN_TIMEOUT_S = 5.0
"""For the thread to end: a link that is told to leave is gone within its close timeouts."""


class Receiver:
    """Runs a link for a call.

    On an event loop that is there: ``await receiver.run()``. Beside a drawing loop: ``with
    receiver: …`` runs it in a thread, and `check` tells the drawing thread what went wrong there.
    """

    def __init__(
        self,
        link_config: LinkConfig,
        call: Call,
        *,
        connector: Connector | None = None,
        rng: random.Random | None = None,
    ) -> None:
        """Prepare; see `Link` for connector and rng."""
        self.call = call
        self.link = Link(link_config, on_event=self._on_event, connector=connector, rng=rng)
        self.arrived = asyncio.Event()
        """Set by every event; for those who wait on the same loop."""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None

    async def run(self) -> None:
        """Receive until `stop`.

        Raises:
            RelayError: The relay is not there, or will not have us.
        """
        self._loop = asyncio.get_running_loop()
        reporting = asyncio.create_task(self._report(), name="reports")
        try:
            await self.link.run()
        finally:
            reporting.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await reporting

    def stop(self) -> None:
        """Make `run` leave the room and return; any thread may call it."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop may be closed by now
                self._loop.call_soon_threadsafe(self.link.leave)

    def check(self) -> None:
        """Raise what ended the thread, if anything did.

        Raises:
            RelayError: As `run`.
        """
        if self._error is not None:
            raise self._error

    @property
    def is_connected(self) -> bool:
        """Whether the relay has us in the room right now."""
        return self.link.is_joined

    def stats(self, now: float) -> dict[str, Any]:
        """`Call.stats`, and the link's side of it."""
        stats = self.call.stats(now)
        counters = self.link.counters
        stats["errors"] += counters.errors
        stats["reconnects"] = self.link.reconnects
        stats["resumes"] = counters.resumes
        stats["received_wire_bytes"] = counters.received_wire_bytes
        stats["seal"] = None if self.link.guard is None else self.link.guard.stats()
        return stats

    def __enter__(self) -> Self:
        started = threading.Event()

        async def main() -> None:
            self._loop = asyncio.get_running_loop()
            started.set()
            await self.run()

        def work() -> None:
            try:
                asyncio.run(main())
            except Exception as error:  # for the other thread to see, see `check`
                self._error = error
            finally:
                started.set()

        self._thread = threading.Thread(target=work, name="receiver", daemon=True)
        self._thread.start()
        started.wait()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.stop()
        if self._thread is not None:
            self._thread.join(timeout=JOIN_TIMEOUT_S)

    def _on_event(self, event: ClientEvent, now: float) -> None:
        self.call.receive_event(event, now)
        for stream in self.call.take_keyframe_requests(now):
            self.link.request_keyframe(stream)
        self.arrived.set()

    async def _report(self) -> None:
        while True:
            await asyncio.sleep(REPORT_INTERVAL_S)
            self.link.report(self.call.take_report())
