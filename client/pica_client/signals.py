"""Ending in good order when the user or the system asks for it."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def on_stop_signal(stop: Callable[[], object]) -> Iterator[None]:
    """Call `stop` on SIGINT and SIGTERM while the block runs; main thread only.

    A second Ctrl-C must not cost the report. The third is a `KeyboardInterrupt`, should anything
    hang; and after the block, when all that is left is to print, those who come are ignored.

    `signal.signal` and not a method of the event loop: the latter is missing on Windows.
    """
    num_stops = 0

    def note(*_: object) -> None:
        nonlocal num_stops
        num_stops += 1
        if num_stops > 2:
            raise KeyboardInterrupt
        stop()

    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, note) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, signal.SIG_IGN if num_stops else handler)


@contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """Let SIGTERM unwind like Ctrl-C while the block runs, so that ``with`` blocks clean up."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
