"""How long frames wait for others to share a message with: not at all, until there is much to do.

A websocket message costs the relay and the network far more than the few bytes of a frame in it
(about 13 microseconds of processor time on loopback, half of them the kernel's). Frames that arrive
in one turn of the event loop share a message anyway, and the busier the loop, the longer its turns:
that alone carried 90,000 deliveries a second on one core. Above a given load the first frame for a
receiver opens a window, which grows with the load up to a longest one, and what comes in it goes
out with that frame: latency, bounded, is given for capacity. Each receiver has its own window; one
for all would make bursts of hundreds of messages, and windows that nothing has come in yet. Control
never waits. Pure.
"""

from typing import Final, Generic, TypeVar

MEASURED_S: Final = 0.25
"""Over which the load is measured (chosen: eight frames of one face)."""


SLACK_S: Final = 0.0005
"""So much too early somebody may leave the line, to be served in one go with others (chosen: half
of what event loops promise)."""

T = TypeVar("T")


class WaitingLine(Generic[T]):
    """Who waits, and until when. Served in the order of coming."""

    def __init__(self) -> None:
        self._due_s: dict[T, float] = {}

    def join(self, who: T, due_s: float) -> None:
        """Wait until ``due_s``; who waits already keeps place and time."""
        self._due_s.setdefault(who, due_s)

    def next_timer(self) -> float | None:
        """Return when the first one is due, or None."""
        return next(iter(self._due_s.values()), None)

    def take_due(self, now: float) -> list[T]:
        """Take those who are due, or all but."""
        due = []
        for who, due_s in self._due_s.items():
            if due_s > now + SLACK_S:
                break
            due.append(who)
        for who in due:
            del self._due_s[who]
        return due


class Coalescing:
    """The window that fits the load.

    Attributes:
        window_s: How long a frame may wait now.
    """

    def __init__(self, above_per_s: float, longest_s: float, now: float) -> None:
        """Begin without any load.

        Args:
            above_per_s: Deliveries a second up to which nothing waits; at four times as many the
                window is at its longest.
            longest_s: The longest window.
            now: The time.
        """
        self.window_s = 0.0
        self._above_per_s = above_per_s
        self._longest_s = longest_s
        self._since_s = now
        self._num = 0

    def note(self, num_deliveries: int, now: float) -> None:
        """Count frames that are to be delivered, one for each receiver."""
        self._num += num_deliveries
        elapsed_s = now - self._since_s
        if elapsed_s >= MEASURED_S:
            excess = self._num / elapsed_s / self._above_per_s - 1
            self.window_s = self._longest_s * min(max(excess / 3, 0.0), 1.0)
            self._since_s, self._num = now, 0
