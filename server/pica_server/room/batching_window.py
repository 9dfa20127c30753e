"""How long frames wait for others to share a message with: not at all, until there is much to do.

A websocket message costs the relay and the network far more than the few bytes of a frame in it
(about 13 microseconds of processor time on loopback, half of them the kernel's). Frames that arrive
in one turn of the event loop share a message anyway. When the loop's thread has hardly a moment
left, the first frame for a receiver opens a window, and what comes in it goes out with that frame:
latency, bounded, is given for capacity. The window grows while the thread stays that busy and
shrinks when it is no longer, so it finds the machine's own limit; a number of frames a second would
be right for one machine. Below, waiting makes latency worse and saves nothing that is needed. Each
receiver has its own window; one for all would make bursts of hundreds of messages, and windows that
nothing has come in yet. Control never waits. Pure.
"""

from typing import Final, Generic, TypeVar

CALM_RATIO: Final = 0.15
"""So much less busy than where the window opens the thread must be for it to shrink (chosen: what a
window saves is more than its last step)."""
GROWTH: Final = 0.25
"""Of the longest window: the step by which it grows where the thread has nothing left (chosen: the
longest within a second)."""
LEAST_S: Final = 0.0005
"""A window that shrinks below this closes: event loops keep no better time."""
SLACK_S: Final = 0.0005
"""So much too early somebody may leave the line, to be served in one go with others (chosen: half
of what event loops promise)."""

T = TypeVar("T")


class BatchingWindow(Generic[T]):
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
        busy_ratio: How much of the last stretch of time the loop's thread worked.
    """

    def __init__(self, busy_above: float, longest_s: float) -> None:
        """Begin without any load.

        Args:
            busy_above: Part of the time, from 0 to below 1, that the loop's thread may work before
                a window opens.
            longest_s: The longest window.
        """
        self.window_s = 0.0
        self.busy_ratio = 0.0
        self._busy_above = busy_above
        self._longest_s = longest_s
        self._since: tuple[float, float] | None = None

    def note(self, processor_s: float, now: float) -> None:
        """Look how busy the loop's thread has been since the last time.

        Called every quarter of a second; the steps are made for that.

        Args:
            processor_s: Processor time that it has used until now.
            now: The time.
        """
        before, self._since = self._since, (processor_s, now)
        if before is None or now <= before[1]:
            return
        self.busy_ratio = (processor_s - before[0]) / (now - before[1])
        excess = (self.busy_ratio - self._busy_above) / (1 - self._busy_above)
        if excess > 0:
            grown_s = self.window_s + GROWTH * self._longest_s * min(excess, 1.0)
            self.window_s = min(max(grown_s, LEAST_S), self._longest_s)
        elif self.busy_ratio < self._busy_above - CALM_RATIO:
            self.window_s = self.window_s * 0.75 if self.window_s * 0.75 >= LEAST_S else 0.0
