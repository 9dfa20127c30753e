"""How good a connection is, for people who do not read numbers: good, fair, poor. Pure.

It is rated by what arrives, and not by what a display made of it: a machine that draws seldom, or
late, does not blame the network. A hiccup causes no warning, and no warning flickers: a level must
be wrong for a while before it changes, and longer for the better than for the worse.

    meter = QualityMeter()
    quality = meter.receive(health, now)        # twice a second, say
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from operator import ge
from typing import Literal, NamedTuple

from pica_client.playout.buffer import PlayoutReport

Quality = Literal["unknown", "good", "fair", "poor"]

WINDOW_S = 4.0
"""Window that is rated (chosen: some 120 frames, so that one is no percent)."""
LEAST_WINDOW_S = 2.0
"""A shorter window is not rated (chosen: of twenty frames two are no measure)."""
WORSE_AFTER_S = 1.5
BETTER_AFTER_S = 5.0
"""How long another level must have been the right one before it is believed."""
MAX_SAMPLES = 64
"""Kept of a window; drops the oldest."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamHealth(PlayoutReport):
    """How a stream stands; counters since it began."""

    payload_bytes: int = 0
    is_paused: bool = False
    """Whether nothing is to be expected: its sender is away or muted."""


class QualityLimits(NamedTuple):
    """Figures from which on a connection is not good any more."""

    lost_ratio: float
    """Frames that were lost, of all."""
    missed_ratio: float
    """Share of the time in which a face stood still because a frame was late."""


FAIR = QualityLimits(lost_ratio=0.03, missed_ratio=0.05)
"""Visible to an attentive viewer (chosen)."""
POOR = QualityLimits(lost_ratio=0.12, missed_ratio=0.2)
"""Visible to everybody: the face stands still a fifth of the time (chosen)."""

_RANK: dict[Quality, int] = {"unknown": 0, "good": 1, "fair": 2, "poor": 3}


def quality_between(before: StreamHealth, after: StreamHealth, seconds: float) -> Quality:
    """What a stream was like between two moments so far apart; unknown when nothing came, or
    too little time has passed."""
    received, lost = after.received - before.received, max(after.lost - before.lost, 0)
    if received + lost <= 0 or seconds < LEAST_WINDOW_S:
        return "unknown"
    missed_s = max(after.missed_s - before.missed_s, 0.0)
    figures = (lost / (received + lost), missed_s / seconds)
    if any(map(ge, figures, POOR)):
        return "poor"
    return "fair" if any(map(ge, figures, FAIR)) else "good"


class QualityMeter:
    """Rates one stream; keeps a bounded window of what it was told."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, StreamHealth]] = deque(maxlen=MAX_SAMPLES)
        self.level: Quality = "unknown"
        """What is shown."""
        self._differs_since_s: float | None = None
        self._is_worse = False

    def skip(self) -> Quality:
        """Forget the window, and show what was shown: this machine was too busy to take frames as
        they came."""
        self._samples.clear()
        self._differs_since_s = None
        return self.level

    def receive(self, health: StreamHealth, now: float) -> Quality:
        """Take how the stream stands at `now`, seconds, and return what to show."""
        if health.is_paused:
            self._samples.clear()
            self.level, self._differs_since_s = "unknown", None
            return self.level
        if self._samples and health.received < self._samples[-1][1].received:
            self._samples.clear()  # the stream began again
        self._samples.append((now, health))
        while len(self._samples) > 2 and now - self._samples[1][0] >= WINDOW_S:
            self._samples.popleft()
        begin_s, before = self._samples[0]
        found = quality_between(before, health, now - begin_s)
        if found == "unknown" or found == self.level:
            self._differs_since_s = None  # a stream that is silent is as good as it was
            return self.level
        is_worse = _RANK[found] > _RANK[self.level]
        if self._differs_since_s is None or is_worse != self._is_worse:
            self._differs_since_s, self._is_worse = now, is_worse
        patience_s = WORSE_AFTER_S if is_worse else BETTER_AFTER_S
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
