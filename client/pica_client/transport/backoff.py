"""How long to wait before trying a relay again. Pure: chance is an argument."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class BackoffConfig:
    """How patient a client is with a relay that is away."""

    first_s: float = 0.25
    """Before the first new try (chosen: a relay that restarts is back within a second)."""
    factor: float = 2.0
    """Growth from one try to the next."""
    longest_s: float = 8.0
    """However long the relay is away, it is found again within this time of its return."""
    settled_s: float = 5.0
    """A connection that lasted this long was a good one: the next trouble starts from `first_s`."""

    def __post_init__(self) -> None:
        if not 0 < self.first_s <= self.longest_s:
            raise ValueError(
                f"first_s is {self.first_s} and longest_s {self.longest_s}; "
                "0 < first_s <= longest_s is needed"
            )
        if not self.factor >= 1:
            raise ValueError(f"factor is {self.factor}; at least 1 is needed")


class Backoff:
    """Waiting times that double up to a bound, each shortened by chance.

    Chance spreads the return of a full room over time: half to all of the nominal wait.
    """

    def __init__(self, random: Callable[[], float], config: BackoffConfig | None = None) -> None:
        """Start fresh; `random` gives numbers in [0, 1)."""
        self.config = config or BackoffConfig()
        self._random = random
        self._nominal_s = self.config.first_s

    def next_wait_s(self, lasted_s: float) -> float:
        """Seconds to wait now.

        Args:
            lasted_s: How long the connection stood that has just ended; 0 if there was none.
        """
        if lasted_s >= self.config.settled_s:
            self._nominal_s = self.config.first_s
        wait_s = self._nominal_s * (0.5 + 0.5 * self._random())
        self._nominal_s = min(self._nominal_s * self.config.factor, self.config.longest_s)
        return wait_s
