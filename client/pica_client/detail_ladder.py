"""The knapsack of a frame: which rungs of everybody's ladders a budget buys. Pure.

Every head has two ladders that lead up from the least it can get: how its maps are decoded, and how
finely it is shaded. A rung counts for the error that it saves per second. Of a ladder only the
rungs on its convex hull are kept, so each is worth less per second than the one before; then the
rungs of all heads, best first, are taken as far as the budget goes. One that does not fit ends its
ladder, and the others go on: the greedy solution of the multiple-choice knapsack (Kellerer,
Pferschy and Pisinger, "Knapsack Problems", 11.2).

More budget never leaves more error: let a rung just begin to fit. What had been taken in its place
cost less than it and was worth no more per second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

Decode = Literal["none", "expression", "both"]

COARSE = 2
"""Shading rate: every second pixel in both directions."""
FINE = 1
_EPSILON = 1e-12
_ANY_RANK = (1 << 30, 0)


class Rung(NamedTuple):
    """A way to treat the maps of a head."""

    cost_s: float
    error: float
    """MSE times the head's weight."""
    rank: tuple[int, int]
    """Level, and how much of it is made anew: what a nearer head must not have less of."""
    place: int
    """Of the level among the avatar's."""
    decode: Decode


@dataclass(kw_only=True, slots=True, eq=False)
class Climber:
    """One head on its two ladders, both at their lowest rung at first."""

    slot: str
    standing: tuple[float, ...]
    """What makes one head outrank another: all of it is at least as much."""
    ladder: list[Rung] = field(default_factory=list)
    """See `hull`; at least one."""
    place: int = 0
    shading_rate: int = COARSE
    fine_cost_s: float = 0.0
    """What fine shading costs over coarse."""
    coarse_error: float = 0.0
    """What coarse shading leaves, times the head's weight."""
    rank_limit: tuple[int, int] = _ANY_RANK
    """No rung above this is open."""
    is_decode_closed: bool = False
    is_shading_closed: bool = False
    is_limited: bool = False
    """Whether the budget kept something from it."""
    outranked: list[Climber] = field(default_factory=list)
    """Whom it outranks; found by `climb` when that begins to matter."""

    @property
    def rung(self) -> Rung:
        """Where it stands on the decode ladder."""
        return self.ladder[self.place]

    def outranks(self, other: Climber) -> bool:
        """Whether this head is nearer than another and moves as much, or more."""
        if self.standing == other.standing:
            return self.slot < other.slot
        for mine, theirs in zip(self.standing, other.standing, strict=True):
            if mine < theirs:  # a loop, for `all` takes twice as long
                return False
        return True


class _Step(NamedTuple):
    """From one rung to the next."""

    worth: float
    """Error saved per second."""
    climber: Climber
    is_decode: bool
    cost_s: float
    rung: int
    """Place in the decode ladder; not used for shading."""


def hull(rungs: list[Rung]) -> list[Rung]:
    """The rungs worth taking, from the cheapest up: each saves less per second than the last."""
    rungs.sort(key=_cheapest_first)
    chain = rungs[:1]
    for rung in rungs[1:]:
        if rung.error >= chain[-1].error - _EPSILON:
            continue
        while len(chain) > 1 and _worth(chain[-1], rung) >= _worth(chain[-2], chain[-1]):
            chain.pop()
        chain.append(rung)
    return chain


def climb(climbers: Sequence[Climber], left_s: float) -> tuple[float, int]:
    """Spend what is left of a budget.

    Args:
        climbers: All at their lowest rungs, by descending `standing`; who comes first goes first
            where worth is equal.
        left_s: The budget less the lowest rungs of all.

    Returns:
        What was spent, and how many rungs were looked at.
    """
    steps = _steps(climbers)
    spent_s = 0.0
    is_tight = sum([step.cost_s for step in steps]) > left_s
    if is_tight:
        for place, climber in enumerate(climbers):
            # Who comes later stands lower in the first respect at least.
            climber.outranked = [o for o in climbers[place + 1 :] if climber.outranks(o)]
    for step in steps:
        spent_s += _take(step, left_s - spent_s)
    return spent_s + (_level_down(climbers) if is_tight else 0.0), len(steps)


def _cheapest_first(rung: Rung) -> tuple[float, float]:
    return rung.cost_s, rung.error


def _worth(low: Rung, high: Rung) -> float:
    return (low.error - high.error) / max(high.cost_s - low.cost_s, _EPSILON)


def _steps(climbers: Sequence[Climber]) -> list[_Step]:
    """All steps of all ladders, the best first; ties stay in order."""
    steps = []
    for climber in climbers:
        ladder = climber.ladder
        for place in range(1, len(ladder)):
            low, high = ladder[place - 1], ladder[place]
            cost_s = max(high.cost_s - low.cost_s, 0.0)
            steps.append(_Step(_worth(low, high), climber, True, cost_s, place))
        if not climber.is_shading_closed:
            cost_s = climber.fine_cost_s
            worth = climber.coarse_error / max(cost_s, _EPSILON)
            steps.append(_Step(worth, climber, False, cost_s, 0))
    steps.sort(key=_best_first)
    return steps


def _best_first(step: _Step) -> float:
    return -step.worth


def _take(step: _Step, left_s: float) -> float:
    """Take a step if it is open and fits; return what it costs."""
    climber = step.climber
    if not step.is_decode:
        if climber.is_shading_closed or step.cost_s > left_s:
            climber.is_limited = climber.is_shading_closed = True
            for other in climber.outranked:
                other.is_shading_closed = True
            return 0.0
        climber.shading_rate = FINE
        return step.cost_s
    if climber.is_decode_closed or climber.ladder[step.rung].rank > climber.rank_limit:
        climber.is_limited = climber.is_decode_closed = True
        return 0.0
    if step.cost_s <= left_s:
        climber.place = step.rung
        return step.cost_s
    climber.is_limited = climber.is_decode_closed = True
    for other in climber.outranked:
        other.rank_limit = min(other.rank_limit, climber.rung.rank)
    return 0.0


def _level_down(climbers: Sequence[Climber]) -> float:
    """Take from heads what they have more than a limited one that outranks them.

    That happens where the two have different pasts or avatars, so that the farther one's rungs came
    first.

    Returns:
        The change of the cost: nothing or less.
    """
    change_s = 0.0
    for climber in climbers:
        if not climber.is_limited:
            continue
        for other in climber.outranked:
            while climber.is_decode_closed and other.place and other.rung.rank > climber.rung.rank:
                other.place -= 1
                change_s += other.rung.cost_s - other.ladder[other.place + 1].cost_s
                other.is_limited = True
            if climber.is_shading_closed and other.shading_rate < climber.shading_rate:
                other.shading_rate = COARSE
                change_s -= other.fine_cost_s
                other.is_limited = True
    return change_s
