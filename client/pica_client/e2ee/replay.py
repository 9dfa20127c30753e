"""Which counters of one key have been seen: a sliding window of bits."""

from typing import Final

WINDOW: Final = 1024
"""Counters that are remembered: 12 s of a face at 30 frames a second and a voice at 50 (chosen:
longer than any delay that a playout would wait for)."""


class ReplayWindow:
    """Lets every counter through once, in any order within the window.

    Ask `is_new` before a frame is opened, `mark` it once it has been: a forged frame must not use
    up a counter.
    """

    def __init__(self, first: int = 0) -> None:
        """Begin with a counter; whatever is below it counts as seen."""
        self._highest = first - 1
        self._seen = (1 << WINDOW) - 1  # bit i: counter highest - i

    def is_new(self, counter: int) -> bool:
        """Whether this counter has not been seen, as far as that can be told."""
        age = self._highest - counter
        return age < 0 or (age < WINDOW and not self._seen >> age & 1)

    def mark(self, counter: int) -> None:
        """Remember a counter that `is_new`."""
        ahead = counter - self._highest
        if ahead > 0:
            shifted = self._seen << ahead if ahead < WINDOW else 0
            self._seen = (shifted | 1) & ((1 << WINDOW) - 1)
            self._highest = counter
        else:
            self._seen |= 1 << -ahead
