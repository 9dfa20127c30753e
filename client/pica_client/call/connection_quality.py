"""How good a connection is, for people who do not read numbers: good, fair, poor. Pure.

A hiccup causes no warning, and no warning flickers: a level must be wrong for a while
before it changes, and longer for the better than for the worse.

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
    """Frames that were lost or late, of all."""
    concealed_ratio: float
    """Display times without a fresh face, of all."""
    age_s: float


FAIR = QualityLimits(lost_ratio=0.03, concealed_ratio=0.05, age_s=0.25)
"""Seen by those who look for it (chosen: the delay beyond which G.114 calls talk affected is 0.15 s
one way, and the face is a part of it)."""
POOR = QualityLimits(lost_ratio=0.12, concealed_ratio=0.2, age_s=0.5)
"""Seen by everybody: the face stands still a fifth of the time (chosen)."""

MIN_SHOWN = 16
"""Display times in a window from which on it says something of the connection, and not of a machine
that draws less than four times a second: there, frames are late, and dropped, for want of a
display."""

_RANK: dict[Quality, int] = {"unknown": 0, "good": 1, "fair": 2, "poor": 3}


def quality_between(before: StreamHealth, after: StreamHealth) -> Quality:
    """What a stream was like between two moments; unknown when nothing came or too little was
    shown."""
    received, shown = after.received - before.received, after.shown - before.shown
    lost = max(after.lost - before.lost, 0) + max(after.late - before.late, 0)
    if received + lost <= 0 or shown < MIN_SHOWN:
        return "unknown"
    concealed = max(after.concealed - before.concealed, 0)
    figures = (lost / (received + lost), concealed / shown, after.age_s)
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

    def receive(self, health: StreamHealth, now: float) -> Quality:
        """Take how the stream stands at `now`, seconds, and say what to show."""
        if health.is_paused:
            self._samples.clear()
            self.level, self._differs_since_s = "unknown", None
            return self.level
        if self._samples and health.received < self._samples[-1][1].received:
            self._samples.clear()  # the stream began again
        self._samples.append((now, health))
        while len(self._samples) > 2 and now - self._samples[1][0] >= WINDOW_S:
            self._samples.popleft()
        found = quality_between(self._samples[0][1], health)
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


def own_quality(peers: Sequence[Quality], *, replaced_ratio: float | None = None) -> Quality:
    """Rate our own connection.

    When most of several streams are poor at once, what they share is this end. What cannot be sent
    in time says it, too.

    Args:
        replaced_ratio: Share of our own frames that the network did not take in time; None when we
            send nothing.
    """
    known = [quality for quality in peers if quality != "unknown"]
    if replaced_ratio is not None and replaced_ratio >= POOR.lost_ratio:
        return "poor"
    if len(known) >= 2 and 2 * known.count("poor") > len(known):
        return "poor"
    return "good" if known or replaced_ratio is not None else "unknown"
