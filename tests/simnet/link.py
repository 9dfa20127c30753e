"""One direction of a connection: when do bytes that are written now arrive? Pure.

A websocket runs over TCP, which neither loses nor reorders: here loss means that a segment arrives
one or more retransmission timeouts later, and that all behind it waits (head-of-line blocking).
True loss and reordering belong into the tests of the buffers that must stand them.

Unrealistic: no congestion control (the window is fixed, loss does not shrink it), no fast
    retransmit (the streams are thin: Linux, too, mostly waits for its timeout), acknowledgements
    cost no time and no rate, and no two connections share a link.
"""

import random
from dataclasses import dataclass

SEGMENT_BYTES = 1448
"""Payload of one TCP segment on Ethernet."""

RETRANSMISSION_TIMEOUT_S = 0.2
"""The least that Linux waits before it sends a lost segment again; doubles with every loss."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Link:
    """What one direction of a connection is like."""

    delay_s: float = 0.0
    """Time from one end to the other."""
    jitter_s: float = 0.0
    """Up to this much is added, uniformly; later bytes still do not overtake."""
    loss_ratio: float = 0.0
    """Share of segments that have to be sent again."""
    rate_bps: float | None = None
    """Bits per second; None is no limit."""
    seed: int = 0
    """Of jitter and loss; each connection goes on from it in its own way."""
    window_bytes: int = 65_536
    """Bytes under way: what the kernels at both ends hold before the writer must wait."""


class StreamLink:
    """The state of one direction of one connection over a ``Link``."""

    def __init__(self, link: Link, salt: str) -> None:
        self.link = link
        self._random = random.Random(f"{link.seed}/{salt}")
        self._free_s = 0.0
        self._last_arrival_s = 0.0

    def transmit(self, num_bytes: int, now: float) -> float:
        """Return when a segment written now arrives."""
        link = self.link
        self._free_s = max(now, self._free_s)
        if link.rate_bps is not None:
            self._free_s += num_bytes * 8 / link.rate_bps
        arrival_s = self._free_s + link.delay_s + self._random.uniform(0, link.jitter_s)
        timeout_s = max(RETRANSMISSION_TIMEOUT_S, 2 * link.delay_s)
        while self._random.random() < link.loss_ratio:
            arrival_s += timeout_s
            timeout_s *= 2
        self._last_arrival_s = max(self._last_arrival_s, arrival_s)
        return self._last_arrival_s

    def hold(self, until_s: float) -> None:
        """Let nothing that is written from now on leave before this time."""
        self._free_s = max(self._free_s, until_s)
