"""How the sender's time goes with ours: offset and drift, from the fastest frames. Pure.

The transit of a frame is its arrival on our clock minus its capture on the sender's: network delay
plus an unknown offset between two clocks, which changes slowly when one of them runs faster. The
network only ever adds, so the *lowest* transits say how offset and drift go:

    fastest transit(t) = level + slope * t      a line that no frame lies below

For each second the lowest transit is kept, for a minute. The line is the edge of the lower convex
hull of these points that spans their middle: of all lines below every point, the one nearest to
them in the mean (Moon, Skelly and Towsley, "Estimation and removal of clock skew from network delay
measurements", INFOCOM 1999). The slope is trusted as far as the points' scatter allows: a few noisy
seconds say nothing about parts in a million, a few clean ones do.

A route that changes, or a sender's clock that is set back a little, bends the line; then the half
of the minute that scatters least about its own line gives the slope.

One frame alone cannot spoil the map: far below the line it pulls it down by `FALL_S`, and only
`NUM_AGREEING` such frames one after the other by as much as all of them say.
"""

import math
from collections import deque
from statistics import median

BLOCK_S = 1.0
"""One lowest transit is kept for each of these (chosen: some frames in each, even at 7.5 fps)."""
NUM_BLOCKS = 60
"""Blocks remembered (chosen: 200 ppm over a minute are 12 ms, far above what noise leaves)."""
MIN_SPAN_S = 5.0
"""Shorter histories give no drift (chosen: 200 ppm are 1 ms by then)."""
MAX_SLOPE = 500e-6
"""Largest drift that is believed (chosen: quartz is within 100 ppm, so two are within 200)."""
USUAL_SLOPE = 100e-6
"""Drift that is expected before anything is known (chosen: one standard deviation of the prior)."""
FALL_S = 0.02
"""Most that one frame may lower the line (chosen: less than anybody sees)."""
NUM_AGREEING = 3
"""Frames in a row that may lower it by more."""
CLOCK_TICK_S = 1e-6
"""Capture times are whole microseconds."""
NUM_FREE_FRAMES = 8
"""Frames at the beginning that may lower the line by any amount: there is nothing to spoil yet."""


class ClockMap:
    """The line of the fastest transit of one stream."""

    def __init__(self, media_s: float, transit_s: float) -> None:
        """Begin with a frame, or with what is known from before."""
        self._anchor_s, self._level_s, self._slope = media_s, transit_s, 0.0
        self._num_frames = 0
        # Lowest (media_s, transit_s) of each closed block; drops its oldest when full.
        self._blocks: deque[tuple[float, float]] = deque(maxlen=NUM_BLOCKS)
        self._lowest = (media_s, transit_s)
        self._block_begin_s: float | None = None
        # Transits as they came; drops its oldest when full.
        self._last: deque[float] = deque(maxlen=NUM_AGREEING)

    @property
    def drift_ppm(self) -> float:
        """How much faster the sender's clock runs than ours, parts in a million."""
        return -self._slope * 1e6

    def fastest_transit_s(self, media_s: float) -> float:
        """Our clock minus the sender's for a frame captured then that nothing delays."""
        return self._level_s + self._slope * (media_s - self._anchor_s)

    def media_s(self, now: float) -> float:
        """The capture time of a frame that comes the fastest way and is here at `now`."""
        # Seen from the anchor, so that large times do not cost digits.
        return self._anchor_s + (now - self._anchor_s - self._level_s) / (1 + self._slope)

    def receive(self, media_s: float, arrived_s: float) -> float:
        """Let a frame move the map.

        Returns:
            Its transit, raised to what the map believed of it.
        """
        transit_s = arrived_s - media_s
        line_s = self.fastest_transit_s(media_s)
        self._num_frames += 1
        self._last.append(transit_s)
        if self._num_frames > NUM_FREE_FRAMES:
            transit_s = max(transit_s, min(line_s - FALL_S, max(self._last)))
        if self._block_begin_s is None:
            self._block_begin_s, self._lowest = arrived_s, (media_s, transit_s)
        elif arrived_s - self._block_begin_s >= BLOCK_S:
            self._blocks.append(self._lowest)
            self._block_begin_s, self._lowest = arrived_s, (media_s, transit_s)
            self._fit()
        elif transit_s - self._lowest[1] < self._slope * (media_s - self._lowest[0]):
            self._lowest = (media_s, transit_s)
        line_s = self.fastest_transit_s(media_s)
        if transit_s < line_s:
            self._level_s -= line_s - transit_s
        return transit_s

    def _fit(self) -> None:
        """Lay the line anew below all blocks."""
        points = sorted({*self._blocks, self._lowest})
        self._slope = _believed_slope(points)
        self._anchor_s = points[-1][0]
        self._level_s = min(
            transit_s - self._slope * (media_s - self._anchor_s) for media_s, transit_s in points
        )


def _believed_slope(points: list[tuple[float, float]]) -> float:
    """The slope below the points, drawn towards none as far as their scatter makes it doubtful."""
    middle = len(points) // 2
    parts = [
        part
        for part in (points, points[:middle], points[middle:])
        if part and part[-1][0] - part[0][0] >= MIN_SPAN_S
    ]
    if not parts:
        return 0.0
    doubt, slope = min(_slope_and_doubt(part)[::-1] for part in parts)
    believed = slope * USUAL_SLOPE**2 / (USUAL_SLOPE**2 + doubt**2)
    return min(max(believed, -MAX_SLOPE), MAX_SLOPE)


def _slope_and_doubt(points: list[tuple[float, float]]) -> tuple[float, float]:
    slope, (begin_s, begin_transit_s) = hull_line(points)
    scatter_s = median(
        transit_s - begin_transit_s - slope * (media_s - begin_s) for media_s, transit_s in points
    )
    # Two ends, each the lowest of its many points, give the slope over the span.
    span_s = points[-1][0] - points[0][0]
    return slope, 2 * max(scatter_s, CLOCK_TICK_S) / (span_s * math.sqrt(len(points)))


def hull_line(points: list[tuple[float, float]]) -> tuple[float, tuple[float, float]]:
    """The line below all points that is nearest to them in the mean: its slope, and a point on it.

    Args:
        points: At least two, in order, not all with the same abscissa.
    """
    hull: list[tuple[float, float]] = []
    for x, y in points:
        if hull and hull[-1][0] == x:
            if hull[-1][1] <= y:
                continue
            hull.pop()
        while len(hull) >= 2:
            (x0, y0), (x1, y1) = hull[-2:]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                break  # the last point lies below the way from the one before it to this one
            hull.pop()
        hull.append((x, y))
    middle = sum(x for x, _ in points) / len(points)
    end = next(place for place, (x, _) in enumerate(hull) if place and x >= middle)
    (x0, y0), (x1, y1) = hull[end - 1 : end + 1]
    return (y1 - y0) / (x1 - x0), (x0, y0)
