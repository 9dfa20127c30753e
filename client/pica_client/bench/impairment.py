"""A bad way through the network, as a model. Pure: `now` and the source of chance are arguments, so
a seed and a list of sends give the same arrivals on every machine.

`Way` says when a piece of so many bytes arrives: `stream_trial` puts a relay in front of it and
sends frames. `SCENARIOS` are the troubles that benches and tests share: each changes one thing
about a calm way of 20 ms.

Delay. Jitter is a positive extra delay with a heavy tail: a Lomax (Pareto II) distribution of shape
3 whose 95th percentile is `jitter_s`; median 0.15, 99th percentile 2.1, cut off at 5 times that.
Successive frames have similar delays: they are the quantiles of a first-order Gaussian process that
forgets within `JITTER_MEMORY_S`.

Loss. On a stream (TCP) nothing is lost and nothing overtakes: a lost piece arrives one
retransmission timeout later, and all behind it waits.

Rate. Pieces leave one after the other. What has not left yet waits with the sender, up to
`queue_bytes` of it where it cannot be taken back: in socket buffers and routers.

Gaps. Now and then a way carries nothing; then what waits leaves in order, as fast as it may.

Cellular links. The rate swings: its logarithm is a first-order Gaussian process that forgets within
`SWING_MEMORY_S`. The lengths of gaps have a log-normal distribution: mostly a tenth of a second,
seldom several seconds. The scenarios have the statistics of what people record on foot, in cars and
in trains: hundreds of gaps above 100 ms in a few minutes, stalls of 0.7 to 11 s. They are no
recordings.

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
SWING_MEMORY_S, SWING_STEP_S = 2.0, 0.02
"""Time constant of a rate's swings, and how often the rate changes."""
MAX_GAP_S = 11.0
"""Longest gap."""
MAX_RETRANSMISSIONS = 6
"""After so many the model lets a piece through: 12.6 s, by when a websocket has given up."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Impairment:
    """What a way does to what travels on it."""

    delay_s: float = 0.02
    """Time from one end to the other without any trouble, one direction."""
    jitter_s: float = 0.0
    """95th percentile of the extra delay; see the module for its distribution."""
    gap_s: float = 0.0
    """Median of how long it carries nothing, now and then; 0 is never."""
    gap_spread: float = 0.0
    """Standard deviation of the logarithm of that."""
    gap_interval_s: float = 2.5
    """Time between a gap's end and the next one; spread by half of it to both sides."""
    loss_ratio: float = 0.0
    """Share of pieces that are late by a retransmission."""
    rate_bps: float | None = None
    """Bits per second, all headers included; None is no limit."""
    rate_swing: float = 0.0
    """Standard deviation of the logarithm of the rate, whose median is `rate_bps`."""
    queue_bytes: int = 4096
    """Bytes that wait where the relay cannot drop them any more: its kernel keeps 2048 unsent, and
    routers have queues (a real bottleneck may hold far more)."""

    def __post_init__(self) -> None:
        check_ranges(self, **dict.fromkeys(("delay_s", "jitter_s", "gap_s"), (0, 10)))
        check_ranges(self, loss_ratio=(0, 0.9), gap_interval_s=(0.1, 600), queue_bytes=(0, 1 << 20))
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
        # Since `change`: times in which it carries one rate, or nothing.
        self._slot_end_s, self._slot_bps = -math.inf, math.inf
        self._gap_begin_s = self._swing_state = 0.0

    def change(self, impairment: Impairment) -> None:
        """Let the way be another from now on; what is under way keeps its time."""
        self.impairment = impairment
        self._slot_end_s = -math.inf

    def transmit(self, num_bytes: int, now: float) -> float:
        """When a piece arrives that leaves now, or once the way is free."""
        way, rng = self.impairment, self._rng
        self.free_s = max(self.free_s, now)
        self._leave(num_bytes * 8)
        arrival_s = self.free_s + way.delay_s + self._jitter_at(self.free_s)
        timeout_s = max(RETRANSMISSION_TIMEOUT_S, 2 * way.delay_s)
        for _ in range(MAX_RETRANSMISSIONS):
            if rng.random() >= way.loss_ratio:
                break
            arrival_s += timeout_s
            timeout_s *= 2
        self._last_arrival_s = max(self._last_arrival_s, arrival_s)
        return self._last_arrival_s

    def _leave(self, num_bits: float) -> None:
        """Move `free_s` to when so many bits have left."""
        while True:
            while self._slot_end_s <= self.free_s:
                self._begin_slot()
            room = (self._slot_end_s - self.free_s) * self._slot_bps
            if num_bits < room:
                self.free_s += num_bits / self._slot_bps
                return
            num_bits -= room
            self.free_s = self._slot_end_s

    def _begin_slot(self) -> None:
        """Go on to the next slot: a gap, or a time of one rate."""
        way, rng = self.impairment, self._rng
        is_first = self._slot_end_s == -math.inf
        begin_s = self.free_s if is_first else self._slot_end_s
        is_gap = not is_first and begin_s >= self._gap_begin_s
        if is_gap:
            length_s = way.gap_s * math.exp(way.gap_spread * rng.standard_normal())
            self._slot_bps, self._slot_end_s = 0.0, begin_s + min(length_s, MAX_GAP_S)
        if is_gap or is_first:
            after_s = way.gap_interval_s * rng.uniform(0.5, 1.5) if way.gap_s else math.inf
            self._gap_begin_s = (begin_s if is_first else self._slot_end_s) + after_s
        if is_gap:
            return
        self._slot_bps, self._slot_end_s = way.rate_bps or math.inf, self._gap_begin_s
        if way.rate_swing:
            kept = math.exp(-SWING_STEP_S / SWING_MEMORY_S)
            fresh = rng.standard_normal() * math.sqrt(1 - kept * kept)
            self._swing_state = kept * self._swing_state + fresh
            self._slot_bps *= math.exp(way.rate_swing * self._swing_state)
            self._slot_end_s = min(begin_s + SWING_STEP_S, self._gap_begin_s)

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


CALM: Final = Impairment()
"""The way before and after a trouble."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Scenario:
    """One row: a name, and the way while the trouble lasts."""

    name: str
    trouble: Impairment
    note: str
    """What happens, for a reader of the table."""
    lasts: int = 1
    """How many times as long as others it is run."""


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
        *(0, 80, 200),
    ),
    *_family(
        *("stall", "every 2.5 s nothing comes for {} ms, then all at once"),
        lambda ms: Impairment(gap_s=ms / 1e3),
        *(300, 1000),
    ),
    *_family(
        *("retransmit", "TCP loses {} % of the segments: each costs 200 ms, also behind it"),
        lambda percent: Impairment(loss_ratio=percent / 100),
        *(1, 5),
    ),
    *_family(
        *("rate", "the way to the receiver carries {} kbit/s, headers included"),
        lambda kbps: Impairment(rate_bps=kbps * 1e3),
        *(64, 32),
    ),
    *(
        Scenario(
            name=f"cellular-{name}",
            trouble=Impairment(
                delay_s=0.03,
                rate_bps=rate_bps,
                rate_swing=rate_swing,
                gap_s=0.12,
                gap_spread=gap_spread,
                gap_interval_s=0.5,
                queue_bytes=16_384,
            ),
            note=f"as a phone {place}: the rate swings, gaps and stalls, then all at once",
            lasts=6,
        )
        for name, place, rate_bps, rate_swing, gap_spread in (
            ("walk", "on foot", 2e6, 0.7, 0.7),
            ("car", "in a car", 1e6, 0.9, 0.95),
            ("train", "in a train", 5e5, 1.1, 1.3),
        )
    ),
)

BY_NAME: Final = {scenario.name: scenario for scenario in SCENARIOS}
