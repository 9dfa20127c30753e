"""The table of troubles that tests and benches share.

Each row changes one thing about a calm way of 20 ms; a bench lets the trouble begin after the first
third of a run and end before the last one, so that recovery shows.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

from pica_client.bench.network.impairment import Impairment
from pica_client.playout.config import PlayoutConfig

ADAPTIVE = PlayoutConfig()
"""What receivers use."""
FIXED = replace(ADAPTIVE, floor_s=0.1, floor_intervals=0.0, ceiling_s=0.1)
"""Always 100 ms behind the fastest frame; moves and conceals as ADAPTIVE does."""
UNBUFFERED = replace(
    ADAPTIVE,
    floor_s=0.0,
    floor_intervals=0.0,
    ceiling_s=0.0,
    leap_s=0.0,
    extrapolate_s=0.0,
    blend_s=0.0,
)
"""Each frame is shown when it comes, unless a newer one is shown already."""
POLICIES = {"adaptive": ADAPTIVE, "fixed": FIXED, "unbuffered": UNBUFFERED}


CALM: Final = Impairment()
DATAGRAM_JITTER_S: Final = 0.02
"""Jitter of the datagram rows (chosen: the least that a home network has)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Scenario:
    """One row: a name, and the way while the trouble lasts."""

    name: str
    trouble: Impairment
    note: str
    """What happens, for a reader of the table."""

    @property
    def calm(self) -> Impairment:
        """The way before and after: the same kind, without the trouble."""
        return replace(CALM, is_ordered=self.trouble.is_ordered)


def _family(
    family: str, note: str, make: Callable[[float], Impairment], *levels: int
) -> Iterator[Scenario]:
    """One row a level; the note says what happens at `{}`."""
    for level in levels:
        yield Scenario(name=f"{family}-{level}", trouble=make(level), note=note.format(level))


def _datagrams(loss: float = 0.0, reorder: float = 0.0, duplicate: float = 0.0) -> Impairment:
    return Impairment(
        is_ordered=False,
        jitter_s=DATAGRAM_JITTER_S,
        loss_ratio=loss,
        reorder_ratio=reorder,
        duplicate_ratio=duplicate,
    )


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
        *("thin", "the relay drops {} % of the frames"),
        lambda percent: Impairment(thin_ratio=percent / 100),
        *(1, 5, 10, 30),
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
    *_family(
        *("loss", "datagrams: {} % of the frames never come"),
        lambda percent: _datagrams(loss=percent / 100),
        *(1, 5, 10, 30),
    ),
    *_family(
        *("reorder", "datagrams: {} % of the frames come 50 ms late; 5 % come twice"),
        lambda percent: _datagrams(reorder=percent / 100, duplicate=0.05),
        *(10, 30),
    ),
)

BY_NAME: Final = {scenario.name: scenario for scenario in SCENARIOS}
