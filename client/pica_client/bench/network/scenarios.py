"""The table of troubles that tests and benches share.

Each row changes one thing about a calm way of 20 ms; a bench lets the trouble begin after the first
third of a run and end before the last one, so that recovery shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from pica_client.bench.network.impairment import Impairment

CALM: Final = Impairment()
DATAGRAM_JITTER_S: Final = 0.02
"""Of the datagram rows (chosen: the least that a home network has)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Scenario:
    """One row: a name, and the way while the trouble lasts."""

    name: str
    family: str
    """Rows of one family differ in one number only."""
    level: float
    """That number, in `unit`."""
    unit: str
    trouble: Impairment
    note: str
    """What happens, for a reader of the table."""

    @property
    def calm(self) -> Impairment:
        """The way before and after: the same kind, without the trouble."""
        return replace(CALM, is_ordered=self.trouble.is_ordered)


def _jitter(level_ms: int) -> Scenario:
    return Scenario(
        name=f"jitter-{level_ms}",
        family="jitter",
        level=level_ms,
        unit="ms",
        trouble=replace(CALM, jitter_s=level_ms / 1e3),
        note=f"95 % of frames at most {level_ms} ms late, in order",
    )


def _stall(level_ms: int) -> Scenario:
    return Scenario(
        name=f"stall-{level_ms}",
        family="stall",
        level=level_ms,
        unit="ms",
        trouble=replace(CALM, stall_s=level_ms / 1e3),
        note=f"every 2.5 s nothing comes for {level_ms} ms, then all at once",
    )


def _thin(percent: int) -> Scenario:
    return Scenario(
        name=f"thin-{percent}",
        family="thin",
        level=percent,
        unit="%",
        trouble=replace(CALM, thin_ratio=percent / 100),
        note=f"the relay drops {percent} % of the frames, upper layers first",
    )


def _rate(kbps: int) -> Scenario:
    return Scenario(
        name=f"rate-{kbps}",
        family="rate",
        level=kbps,
        unit="kbit/s",
        trouble=replace(CALM, rate_bps=kbps * 1e3),
        note=f"the way to the receiver carries {kbps} kbit/s, headers included",
    )


def _retransmit(percent: int) -> Scenario:
    return Scenario(
        name=f"retransmit-{percent}",
        family="retransmit",
        level=percent,
        unit="%",
        trouble=replace(CALM, loss_ratio=percent / 100),
        note=f"TCP loses {percent} % of the segments: each costs 200 ms, for all behind it too",
    )


def _loss(percent: int) -> Scenario:
    return Scenario(
        name=f"loss-{percent}",
        family="loss",
        level=percent,
        unit="%",
        trouble=Impairment(loss_ratio=percent / 100, jitter_s=DATAGRAM_JITTER_S, is_ordered=False),
        note=f"datagrams: {percent} % of the frames never come, whatever their layer",
    )


def _reorder(percent: int) -> Scenario:
    return Scenario(
        name=f"reorder-{percent}",
        family="reorder",
        level=percent,
        unit="%",
        trouble=Impairment(
            reorder_ratio=percent / 100,
            duplicate_ratio=0.05,
            jitter_s=DATAGRAM_JITTER_S,
            is_ordered=False,
        ),
        note=f"datagrams: {percent} % of the frames come 50 ms late, overtaken; 5 % come twice",
    )


SCENARIOS: Final[tuple[Scenario, ...]] = (
    *map(_jitter, (0, 20, 80, 200)),
    *map(_stall, (100, 300, 1000)),
    *map(_thin, (1, 5, 10, 30)),
    *map(_retransmit, (1, 5)),
    *map(_rate, (64, 32, 16)),
    *map(_loss, (1, 5, 10, 30)),
    *map(_reorder, (10, 30)),
)

BY_NAME: Final = {scenario.name: scenario for scenario in SCENARIOS}
