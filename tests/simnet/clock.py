"""An event loop whose clock jumps to the next timer: minutes of a call in milliseconds, repeatably.

    @in_virtual_time
    async def test_silent_peer_is_closed_after_twenty_seconds(): ...

Nothing in such a test waits for real: no socket, no thread, no executor. ``create_server`` and
``create_connection`` go to the simulated network (``simnet.network``), so real clients and the real
relay run unchanged. When nothing is scheduled any more, time could stand still for ever: the loop
raises RuntimeError instead. A test that leaves tasks behind fails, and one in which a task failed
unseen.

Unrealistic: code takes no time, however long it runs, of the processor neither (a relay that counts
    the real seconds that its thread works would believe itself overloaded on a busy machine); all
    callbacks of one moment run in the order in which they were scheduled.
"""

import asyncio
import functools
import random
import selectors
import socket
from collections.abc import Callable, Coroutine
from typing import Any, ParamSpec, TypeVar
from unittest import mock

from simnet.network import Network

P = ParamSpec("P")
T = TypeVar("T")

GRACE_S = 0.001
"""What cancelled tasks get to end in, before they count as left behind."""


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """An asyncio loop on a virtual clock that starts at 0, with a simulated network."""

    def __init__(self, limit_s: float) -> None:
        self._now = 0.0
        self._limit_s = limit_s
        super().__init__(selector=_JumpingSelector(self._jump))
        self.network = Network(self)

    def time(self) -> float:
        return self._now

    async def create_connection(self, *args: Any, **kwargs: Any) -> Any:
        return await self.network.create_connection(*args, **kwargs)

    async def getaddrinfo(self, host: Any, port: Any, **_kwargs: Any) -> Any:
        # The simulated network knows hosts by name; nothing is looked up.
        return [(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP, "", (host, port))]

    async def create_server(self, *args: Any, **kwargs: Any) -> Any:
        return self.network.create_server(*args, **kwargs)

    def run_in_executor(self, *_args: Any) -> Any:
        raise RuntimeError("no threads in virtual time: their work would take no time or for ever")

    def _jump(self, seconds: float | None) -> None:
        if seconds is None:
            raise RuntimeError(f"nothing is scheduled at t = {self._now} s")
        # Rounded, so that sums of timeouts do not drift away from the numbers in a test.
        self._now = round(self._now + seconds, 9)
        if self._now > self._limit_s:
            raise RuntimeError(f"still running after {self._limit_s} virtual seconds")


class _JumpingSelector(selectors.DefaultSelector):
    """Never sleeps: where a selector would wait, the clock jumps."""

    def __init__(self, jump: Callable[[float | None], None]) -> None:
        super().__init__()
        self._jump = jump

    def select(self, timeout: float | None = None) -> Any:
        events = super().select(0)
        if not events and (timeout is None or timeout > 0):
            self._jump(timeout)
        return events


def run_virtual(main: Coroutine[Any, Any, T], *, limit_s: float = 3600.0) -> T:
    """Run a coroutine on a fresh virtual clock and network, and check that it leaves no task."""
    random.seed(1)  # spreads reconnects
    with (
        mock.patch("time.thread_time", float),
        asyncio.Runner(loop_factory=lambda: VirtualTimeLoop(limit_s)) as runner,
    ):
        return runner.run(_supervised(main))


def in_virtual_time(test: Callable[P, Coroutine[Any, Any, None]]) -> Callable[P, None]:
    """Make a test function of an async one that runs on the virtual clock."""

    @functools.wraps(test)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        run_virtual(test(*args, **kwargs))

    return run


def current_network() -> Network:
    """Return the simulated network of the running loop."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualTimeLoop)
    return loop.network


async def _supervised(main: Coroutine[Any, Any, T]) -> T:
    unheard: list[str] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _, context: unheard.append(str(context)))
    result = await main
    await asyncio.sleep(GRACE_S)
    if unheard:
        raise AssertionError(f"errors that were not handled: {unheard}")
    left = asyncio.all_tasks() - {asyncio.current_task()}
    if left:
        raise AssertionError(f"{len(left)} tasks left: {sorted(map(repr, left))}")
    return result
