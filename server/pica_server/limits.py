"""How much is too much: token buckets. Pure: times are arguments."""


class TokenBucket:
    """Lets through ``rate`` a second on average and ``burst`` at once.

    It starts full.
    """

    __slots__ = ("_burst", "_filled_s", "_level", "_rate")

    def __init__(self, rate: float, burst: float, now: float) -> None:
        self._rate = rate
        self._burst = burst
        self._level = burst
        self._filled_s = now

    def take(self, now: float, amount: float = 1.0) -> bool:
        """Take ``amount`` out of the bucket, or return False and leave it as it is."""
        # A clock that goes back must not drain it.
        elapsed_s = max(now - self._filled_s, 0.0)
        self._level = min(self._level + elapsed_s * self._rate, self._burst)
        self._filled_s = now
        if amount > self._level:
            return False
        self._level -= amount
        return True
