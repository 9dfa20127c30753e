"""How good a connection is, for people who do not read numbers: good or poor. Pure.

It is rated by how late frames arrive, and not by what a display made of them: a machine that draws
seldom, or late, does not blame the network. Nor do frames count that never come: nothing is lost on
a websocket, so they were left out for newer ones, as a sender on a busy machine does, and a face
whose other frames are in time moves on. A hiccup causes no warning, and no warning flickers: a
level must be wrong for a while before it changes, and longer for the better than for the worse.

    meter = QualityMeter()
    quality = meter.receive(report, now)        # twice a second, say
"""

from collections import deque
from collections.abc import Sequence
from typing import Literal

from pica_client.playout.buffer import PlayoutReport

Quality = Literal["unknown", "good", "poor"]

WINDOW_S = 4.0
"""Window that is rated (chosen: some 120 frames, so that one is no percent)."""
LEAST_WINDOW_S = 2.0
"""A shorter window is not rated (chosen: of twenty frames two are no measure)."""
WORSE_AFTER_S = 1.5
BETTER_AFTER_S = 5.0
"""How long another level must have been the right one before it is believed."""
MAX_SAMPLES = 64
"""Kept of a window; drops the oldest."""
POOR_MISSED_RATIO = 0.12
"""Share of the time in which a face stood still because a frame was late, from which on a
connection is poor (chosen: simulated links on which a face stands still for a quarter of the time
or more have 0.12 to 0.6, those on which it hardly does 0.05 at most, busy machines 0.01)."""


class QualityMeter:
    """Rates one stream; keeps a bounded window of what it was told."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, PlayoutReport]] = deque(maxlen=MAX_SAMPLES)
        self.level: Quality = "unknown"
        """What is shown."""
        self._differs_since_s: float | None = None

    def skip(self) -> Quality:
        """Forget the window, and show what was shown: this machine was too busy to take frames as
        they came."""
        self._samples.clear()
        self._differs_since_s = None
        return self.level

    def pause(self) -> Quality:
        """Nothing is to be expected: the sender is away or muted."""
        self.level = "unknown"
        return self.skip()

    def receive(self, report: PlayoutReport, now: float) -> Quality:
        """Take how the stream stands at `now`, seconds, and return what to show."""
        if self._samples and report.received < self._samples[-1][1].received:
            self._samples.clear()  # the stream began again
        self._samples.append((now, report))
        while len(self._samples) > 2 and now - self._samples[1][0] >= WINDOW_S:
            self._samples.popleft()
        begin_s, before = self._samples[0]
        is_poor = report.missed_s - before.missed_s >= POOR_MISSED_RATIO * (now - begin_s)
        found: Quality = "poor" if is_poor else "good"
        is_rated = report.received > before.received and now - begin_s >= LEAST_WINDOW_S
        if not is_rated or found == self.level:
            self._differs_since_s = None  # a stream that is silent is as good as it was
            return self.level
        if self._differs_since_s is None:
            self._differs_since_s = now
        patience_s = WORSE_AFTER_S if found == "poor" else BETTER_AFTER_S
        if self.level == "unknown" or now - self._differs_since_s >= patience_s:
            self.level, self._differs_since_s = found, None
        return self.level


def own_quality(peers: Sequence[Quality], sent: Quality = "unknown") -> Quality:
    """Rate our own connection.

    When most of several streams are poor at once, what they share is this end. What cannot be sent
    in time says it, too.

    Args:
        sent: How the network takes our own frames.
    """
    known = [quality for quality in peers if quality != "unknown"]
    if sent == "poor" or (len(known) >= 2 and 2 * known.count("poor") > len(known)):
        return "poor"
    return "good" if known or sent != "unknown" else "unknown"
