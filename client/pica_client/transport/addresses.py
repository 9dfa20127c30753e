"""Which of several relays is tried next. Pure."""

from collections.abc import Sequence


class Addresses:
    """The relays of a link, tried in order; between two rounds through all of them it waits.

    Attributes:
        current: The one that we are at, or try now.
    """

    def __init__(self, urls: Sequence[str]) -> None:
        """Begin with the first of them."""
        self.current = urls[0]
        self._urls = tuple(urls)
        self._round = list(urls)

    @property
    def num_left(self) -> int:
        """How many are to be tried before the round is over."""
        return len(self._round)

    def take(self) -> str:
        """Go on to the next of the round, of a new one if it is over."""
        if not self._round:
            self._round = list(self._urls)
        self.current = self._round.pop(0)
        return self.current

    def begin_with(self, url: str) -> None:
        """Begin a round with one of them, or with one that a relay has sent us to."""
        self._round = [url, *(other for other in self._urls if other != url)]

    def beside(self, index: int) -> str:
        """Return what is tried beside the current one, the time `index`: itself, then the others
        in order, and so on."""
        others = [url for url in self._urls if url != self.current]
        return [self.current, *others][index % (len(others) + 1)]
