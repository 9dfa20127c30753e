"""The sound of a recording: voices as they were heard and as they were said, on one time line."""

import threading
from collections.abc import Callable

import numpy as np

from pica_client.voice.opus import SAMPLE_RATE_HZ
from pica_core.types import FloatArray

MAX_ERROR_S = 0.03
"""Error of a place that is mended by a leap; less is not heard (chosen: a picture)."""
LATE_S = 0.5
"""Sound that is younger than this may not have come yet."""
MAX_SECONDS = 30.0
"""Sound that waits to be taken at most; more is dropped, as the recording has stopped drawing."""


class Soundtrack:
    """Takes sound on any thread, and gives it to a recording.

    Attributes:
        close: To be called once nothing more is wanted.
    """

    def __init__(self, on_close: Callable[[], None] = lambda: None) -> None:
        self.close = on_close
        self._lock = threading.Lock()
        self._begin_s: float | None = None
        self._sum = np.zeros((0, 2), np.float32)  # from sample number _at on
        self._at = 0
        self._ends: dict[str, int] = {}  # number of the next sample

    def begin(self, now: float) -> None:
        """Set when the recording begins; earlier sound is left out."""
        with self._lock:
            self._begin_s = now

    def add(self, who: str, sound: FloatArray, time_s: float) -> None:
        """Take the next sound of a source, float32 ``[n]`` or ``[n, 2]``, and when it begins."""
        with self._lock:
            if self._begin_s is None:
                return
            place = round((time_s - self._begin_s) * SAMPLE_RATE_HZ)
            end = self._ends.get(who, place)
            if abs(place - end) > MAX_ERROR_S * SAMPLE_RATE_HZ:
                end = place
            self._ends[who] = end + len(sound)
            both = sound if sound.ndim == 2 else np.repeat(sound[:, None], 2, axis=1)
            first = end - self._at
            both, first = both[max(-first, 0) :], max(first, 0)
            if first + len(both) > MAX_SECONDS * SAMPLE_RATE_HZ:
                return
            missing = first + len(both) - len(self._sum)
            if missing > 0:
                more = max(missing, SAMPLE_RATE_HZ)  # seldom, and so cheaply
                self._sum = np.concatenate([self._sum, np.zeros((more, 2), np.float32)])
            self._sum[first : first + len(both)] += both

    def take(self, until_s: float) -> tuple[FloatArray, int]:
        """All up to a time after the beginning that was not given yet, float32 ``[n, 2]`` within
        [-1, 1], and the number of its first sample. Gaps are silence."""
        with self._lock:
            count = max(round(until_s * SAMPLE_RATE_HZ) - self._at, 0)
            taken = np.zeros((count, 2), np.float32)
            there = self._sum[:count]
            taken[: len(there)] = np.clip(there, -1, 1)
            first, self._sum = self._at, self._sum[count:]
            self._at += count
        return taken, first
