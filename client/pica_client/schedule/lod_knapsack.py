"""The knapsack of a frame: which rungs of everybody's ladders a budget buys. Pure.

Every head has a ladder that leads up from the least it can get: how its maps are decoded, and with
how many triangles they are drawn. A rung counts for the error that it saves per second. Of a ladder
only the rungs on its convex hull are kept, so each is worth less per second than the one before;
then the rungs of all heads, best first, are taken as far as the budget goes. One that does not fit
ends its ladder, and the others go on: the greedy solution of the multiple-choice knapsack
(Kellerer, Pferschy and Pisinger, "Knapsack Problems", 11.2).

More budget never leaves more error: let a rung just begin to fit. What had been taken in its place
cost less than it and was worth no more per second.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

Decode = Literal["none", "expression", "both"]

_EPSILON = 1e-12
_ANY_RANK = (1 << 30, 0, 0)


class Rung(NamedTuple):
    """A way to treat the maps of a head."""

    cost_s: float
    error: float
    """MSE times the head's weight."""
    rank: tuple[int, int, int]
    """Level, how much of it is made anew, and mesh: what a nearer head must not have less of."""
    place: int
    """Of the level among the avatar's."""
    decode: Decode
    mesh: int = 0
    """Place of the level whose triangles are drawn."""


@dataclass(kw_only=True, slots=True, eq=False)
class Climber:
    """One head on its ladder, at its lowest rung at first."""

    nearness: tuple[float, ...]
    """Of a nearer head all of it is at least as much."""
    motion: tuple[float, ...] = ()
    """Of a head that moves as much all of it is at least as much."""
    ladder: list[Rung]
    """See `hull`; at least one."""
    worths: list[float]
    """What its steps are worth."""
    place: int = 0
    rank_limit: tuple[int, int, int] = _ANY_RANK
    """No rung above this is open."""
    is_closed: bool = False
    is_limited: bool = False
    """Whether the budget kept something from it."""
    outranked: list[Climber] = field(default_factory=list)
    """Who is farther and moves no more, and so must not have more; found by `climb` when that
    begins to matter."""

    @property
    def rung(self) -> Rung:
        """Where it stands."""
        return self.ladder[self.place]


class _Step(NamedTuple):
    """From one rung to the next."""

    worth: float
    """Error saved per second."""
    climber: Climber
    cost_s: float
    place: int


def hull(rungs: list[Rung]) -> tuple[list[Rung], list[float]]:
    """The rungs worth taking, from the cheapest up.

    Returns:
        The rungs, and what it is worth to step on each from the one before, in error saved per
        second: less with every step. The first is infinitely worth.
    """
    rungs.sort(key=_cheapest_first)
    low = rungs[0]
    chain, worths = [low], [math.inf]
    for rung in rungs[1:]:
        if rung.error >= low.error - _EPSILON:
            continue
        while True:
            low = chain[-1]
            worth = (low.error - rung.error) / max(rung.cost_s - low.cost_s, _EPSILON)
            if worth < worths[-1]:
                break
            chain.pop()
            worths.pop()
        chain.append(rung)
        worths.append(worth)
        low = rung
    return chain, worths


def climb(climbers: Sequence[Climber], left_s: float) -> tuple[float, int]:
    """Spend what is left of a budget.

    Args:
        climbers: All at their lowest rungs, the nearest first; who comes first goes first where
            worth is equal.
        left_s: The budget less the lowest rungs of all.

    Returns:
        What was spent, and how many rungs were looked at.
    """
    steps = _steps(climbers)
    total_s = sum([step.cost_s for step in steps])
    if total_s <= left_s:
        for step in steps:
            _go(step)
        return total_s, len(steps)
    for place, climber in enumerate(climbers):
        climber.outranked = [
            other
            for other in climbers[place + 1 :]
            if _covers(climber.nearness, other.nearness) and _covers(climber.motion, other.motion)
        ]
    spent_s = 0.0
    for step in steps:
        spent_s += _take(step, left_s - spent_s)
    freed_s = _level_down(climbers)
    if freed_s > 0:
        spent_s -= freed_s
        for climber in climbers:
            climber.rank_limit, climber.is_closed = _ANY_RANK, False
        for step in steps:
            if step.place == step.climber.place + 1:
                spent_s += _take(step, left_s - spent_s)
        spent_s -= _level_down(climbers)
    return spent_s, len(steps)


def _covers(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    for mine, theirs in zip(one, other, strict=True):  # noqa: SIM110 - `all` takes twice as long
        if mine < theirs:
            return False
    return True


def _cheapest_first(rung: Rung) -> tuple[float, float]:
    return rung.cost_s, rung.error


def _steps(climbers: Sequence[Climber]) -> list[_Step]:
    """All steps of all ladders, the best first; ties stay in order."""
    steps = []
    for climber in climbers:
        ladder, worths = climber.ladder, climber.worths
        before_s = ladder[0].cost_s
        for place in range(1, len(ladder)):
            after_s = ladder[place].cost_s
            steps.append(_Step(worths[place], climber, after_s - before_s, place))
            before_s = after_s
    steps.sort(key=_best_first)
    return steps


def _best_first(step: _Step) -> float:
    return -step.worth


def _go(step: _Step) -> None:
    step.climber.place = step.place


def _take(step: _Step, left_s: float) -> float:
    """Take a step if it is open and fits; return what it costs."""
    climber = step.climber
    rung = climber.ladder[step.place]
    if climber.is_closed or (rung.decode != "none" and rung.rank > climber.rank_limit):
        climber.is_limited = climber.is_closed = True
        return 0.0
    if step.cost_s <= left_s:
        _go(step)
        return step.cost_s
    climber.is_limited = climber.is_closed = True
    for other in climber.outranked:
        other.rank_limit = min(other.rank_limit, climber.rung.rank)
    return 0.0


def _level_down(climbers: Sequence[Climber]) -> float:
    """Take from heads what they have more than a limited one that is nearer and moves as much.

    That happens where the two have different pasts or avatars, so that the farther one's rungs came
    first. Maps that it has already it may keep.

    Returns:
        What that saves.
    """
    saved_s = 0.0
    for climber in climbers:
        if not climber.is_closed:
            continue
        for other in climber.outranked:
            while (
                other.place and other.rung.decode != "none" and other.rung.rank > climber.rung.rank
            ):
                other.place -= 1
                other.is_limited = True
                saved_s += other.ladder[other.place + 1].cost_s - other.rung.cost_s
    return saved_s
