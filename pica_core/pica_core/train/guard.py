"""Tells a run that diverges from one that wobbles."""

import math
from collections.abc import Mapping

EXPLOSION_FACTOR = 100.0
"""How far above its usual value the sum of losses must lie to count as an explosion (chosen: rare
frames reach 10)."""
PATIENCE = 5
"""Steps in a row that must lie so high."""
MEMORY = 0.95
"""Share of the usual value that a step leaves in place."""
SETTLED_STEPS = 20
"""Steps of a phase before anything is usual."""


class DivergenceGuard:
    """Looks at the losses of one step after the other."""

    def __init__(self) -> None:
        self._phase = ""
        self._steps = 0
        self._usual = 0.0
        self._high = 0

    def check(self, phase: str, losses: Mapping[str, float]) -> str | None:
        """Take the losses of a step, weighted, by name, and say what is wrong with them. A new
        phase begins a new memory."""
        if phase != self._phase:
            self._phase, self._steps, self._high = phase, 0, 0
        broken = [name for name, value in losses.items() if not math.isfinite(value)]
        if broken:
            return f"{', '.join(broken)} not finite"
        total = sum(abs(value) for value in losses.values())
        usual = self._usual
        if self._steps >= SETTLED_STEPS and total > EXPLOSION_FACTOR * usual:
            self._high += 1
            if self._high >= PATIENCE:
                return f"losses {total:.4g} in {PATIENCE} steps, {usual:.4g} before"
            return None
        self._high = 0
        self._usual = total if self._steps == 0 else MEMORY * usual + (1 - MEMORY) * total
        self._steps += 1
        return None
