"""When the next frame is due. Pure: `now` is an argument."""

import math


class Pacer:
    """An absolute schedule: frame k is due k / fps after the first, so small delays never add up.

    Who is late by more than a frame skips to the newest one that is due: a sender sends the face of
    now, not those it has missed.

    Attributes:
        num_skipped: Frames that were never due in time.
    """

    def __init__(self, fps: float, now: float) -> None:
        """Start; the first frame is due at once."""
        self._fps = fps
        self._begin_s = now
        self._index = 0
        self.num_skipped = 0

    @property
    def due_s(self) -> float:
        """When the next frame is due."""
        return self._begin_s + self._index / self._fps

    def advance(self, now: float) -> None:
        """The frame that was due is done; go on to the next."""
        following = self._index + 1
        # The tolerance keeps a frame that ends exactly on the next one's time from being skipped.
        newest_due = math.floor((now - self._begin_s) * self._fps + 1e-6)
        self._index = max(following, newest_due)
        self.num_skipped += self._index - following
