"""A bad way through the network, as a model. Pure: `now` and the source of chance are arguments, so
a seed and a list of sends give the same arrivals on every machine.

`Way` says when a piece of so many bytes arrives: `stream_trial` puts a relay in front of it and
sends frames. `SCENARIOS` are the troubles that benches and tests share: each changes one thing
about a calm way of 20 ms.

Delay. Jitter is a positive extra delay with a heavy tail: a Lomax (Pareto II) distribution of shape
3 whose 95th percentile is `jitter_s`; median 0.15, 99th percentile 2.1, cut off at 5 times that.
Successive frames have similar delays: they are the quantiles of a first-order Gaussian process that
forgets within `JITTER_MEMORY_S`. A stall holds everything for `stall_s`; then all of it comes at
once, in order.

Loss. On a stream (TCP) nothing is lost and nothing overtakes: a lost piece arrives one
retransmission timeout later, and all behind it waits.

Rate. Pieces leave one after the other. What has not left yet waits with the sender, up to
`queue_bytes` of it where it cannot be taken back: in socket buffers and routers.

Unrealistic: no congestion control, so loss does not shrink a window and a rate is a fixed figure;
no fast retransmit and no tail-loss probe (streams as thin as ours mostly wait for the timeout, but
not always); losses do not come in bursts; delay, loss and rate do not depend on each other; no two
connections share a way.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from pica_client.errors import check_ranges

JITTER_MEMORY_S = 0.1
"""Time constant of the jitter (chosen: what a queue behind another's burst takes to drain)."""
JITTER_SHAPE = 3.0
"""Shape of the Lomax distribution: its variance is finite, its kurtosis is not."""
MAX_JITTER_RATIO = 5.0
"""Longest extra delay in units of `jitter_s`; one frame in 870 would exceed it."""
RETRANSMISSION_TIMEOUT_S = 0.2
"""Linux's TCP_RTO_MIN, which a thin stream over a short way waits for; doubles with every loss."""
MAX_RETRANSMISSIONS = 6
"""After so many the model lets a piece through: 12.6 s, by when a websocket has given up."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Impairment:
    """What a way does to what travels on it."""

    delay_s: float = 0.02
    """Time from one end to the other without any trouble, one direction."""
    jitter_s: float = 0.0
    """95th percentile of the extra delay; see the module for its distribution."""
    stall_s: float = 0.0
    """How long a head-of-line stall holds everything; 0 is never."""
    stall_interval_s: float = 2.5
    """Time between a stall's end and the next one; spread by half of it to both sides."""
    loss_ratio: float = 0.0
    """Share of pieces that are late by a retransmission."""
    rate_bps: float | None = None
    """Bits per second, all headers included; None is no limit."""
    queue_bytes: int = 4096
    """Bytes that wait where the relay cannot drop them any more: its kernel keeps 2048 unsent, and
    routers have queues (a real bottleneck may hold far more)."""

    def __post_init__(self) -> None:
        check_ranges(self, **dict.fromkeys(("delay_s", "jitter_s", "stall_s"), (0, 10)))
        check_ranges(
            self, loss_ratio=(0, 0.9), stall_interval_s=(0.1, 600), queue_bytes=(0, 1 << 20)
        )
        check_ranges(self, rate_bps=(1000, 1e10))


class Way:
    """One direction of one connection: when does what is sent now arrive?

    Attributes:
        free_s: When the next piece can leave, seconds.
    """

    def __init__(self, impairment: Impairment, rng: np.random.Generator) -> None:
        self.impairment = impairment
        self._rng = rng
        self.free_s = -math.inf
        self._last_arrival_s = -math.inf
        self._jitter_state = float(rng.standard_normal())
        self._jitter_time_s = -math.inf
        self._stall: tuple[float, float] | None = None

    def change(self, impairment: Impairment) -> None:
        """Let the way be another from now on; what is under way keeps its time."""
        self.impairment = impairment
        self._stall = None

    def transmit(self, num_bytes: int, now: float) -> float:
        """When a piece arrives that leaves now, or once the way is free."""
        way, rng = self.impairment, self._rng
        self.free_s = max(self.free_s, now)
        if way.rate_bps is not None:
            self.free_s += num_bytes * 8 / way.rate_bps
        arrival_s = self.free_s + way.delay_s + self._jitter_at(self.free_s)
        timeout_s = max(RETRANSMISSION_TIMEOUT_S, 2 * way.delay_s)
        for _ in range(MAX_RETRANSMISSIONS):
            if rng.random() >= way.loss_ratio:
                break
            arrival_s += timeout_s
            timeout_s *= 2
        arrival_s = self._after_stall(arrival_s, now)
        self._last_arrival_s = max(self._last_arrival_s, arrival_s)
        return self._last_arrival_s

    def _jitter_at(self, now: float) -> float:
        """The extra delay of a piece that leaves now."""
        kept = math.exp(-max(now - self._jitter_time_s, 0.0) / JITTER_MEMORY_S)
        self._jitter_time_s = now
        fresh = float(self._rng.standard_normal())
        self._jitter_state = kept * self._jitter_state + math.sqrt(1 - kept * kept) * fresh
        above = 0.5 * math.erfc(self._jitter_state / math.sqrt(2))  # share of longer delays
        scale = math.pow(0.05, -1 / JITTER_SHAPE) - 1
        ratio = (math.pow(max(above, 1e-12), -1 / JITTER_SHAPE) - 1) / scale
        return self.impairment.jitter_s * min(ratio, MAX_JITTER_RATIO)

    def _after_stall(self, arrival_s: float, now: float) -> float:
        """The arrival, moved to the end of a stall that it falls into."""
        if self.impairment.stall_s == 0:
            return arrival_s
        if self._stall is None:
            self._stall = self._next_stall(now - self.impairment.stall_interval_s / 2)
        while arrival_s >= self._stall[1]:
            self._stall = self._next_stall(self._stall[1])
        return self._stall[1] if arrival_s >= self._stall[0] else arrival_s

    def _next_stall(self, after_s: float) -> tuple[float, float]:
        begin_s = after_s + self.impairment.stall_interval_s * self._rng.uniform(0.5, 1.5)
        return begin_s, begin_s + self.impairment.stall_s


CALM: Final = Impairment()
"""The way before and after a trouble."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Scenario:
    """One row: a name, and the way while the trouble lasts."""

    name: str
    trouble: Impairment
    note: str
    """What happens, for a reader of the table."""


def _family(
    family: str, note: str, make: Callable[[float], Impairment], *levels: int
) -> Iterator[Scenario]:
    """One row a level; the note says what happens at `{}`."""
    for level in levels:
        yield Scenario(name=f"{family}-{level}", trouble=make(level), note=note.format(level))


SCENARIOS: Final[tuple[Scenario, ...]] = (
    *_family(
        *("jitter", "95 % of frames at most {} ms late, in order"),
        lambda ms: Impairment(jitter_s=ms / 1e3),
        *(0, 20, 80, 200),
    ),
    *_family(
        *("stall", "every 2.5 s nothing comes for {} ms, then all at once"),
        lambda ms: Impairment(stall_s=ms / 1e3),
        *(100, 300, 1000),
    ),
    *_family(
        *("retransmit", "TCP loses {} % of the segments: each costs 200 ms, also behind it"),
        lambda percent: Impairment(loss_ratio=percent / 100),
        *(1, 5),
    ),
    *_family(
        *("rate", "the way to the receiver carries {} kbit/s, headers included"),
        lambda kbps: Impairment(rate_bps=kbps * 1e3),
        *(64, 32, 16),
    ),
)

BY_NAME: Final = {scenario.name: scenario for scenario in SCENARIOS}
