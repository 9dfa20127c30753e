"""What all live sources share: samples go in when they come, a face comes out when it is asked
for."""

import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

from pica_client.sources.live.calibration import Calibration
from pica_client.sources.live.live_face import LiveFace
from pica_client.sources.live.sample import TrackerSample
from pica_core.avatar.arkit import ExpressionFrame
from pica_core.types import Image

SampleTap = Callable[[TrackerSample, float, float], None]
"""Sees a sample, when it arrived on this machine's monotonic clock, and how long it took to be
a face, seconds; called by the thread that reads."""
END_S = 1.0
"""How long a reader has to end: a call waits meanwhile."""


class Tracker(ABC):
    """A live source: its face is that of now, whatever time is asked for. What reads it is for
    those that inherit from this, which start the thread.

    Attributes:
        refused: How often something came that is not the tracker's, by reason.
        subjects: How many samples each subject has sent.
    """

    def __init__(self, calibration: Calibration | None, tap: SampleTap | None) -> None:
        self.face = LiveFace(calibration)
        self.refused: Counter[str] = Counter()
        self.subjects: Counter[str] = Counter()
        self._tap = tap
        self._begin_s: float | None = None
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._read, name=type(self).__name__, daemon=True)

    def frame_at(self, time_s: float) -> ExpressionFrame:
        """The face of now; see `Source.frame_at`."""
        now = time.monotonic()
        with self._lock:
            frame = self.face.face_at(now)
        if self._begin_s is None:
            self._begin_s = now - time_s
        return replace(frame, captured_us=frame.captured_us - round(self._begin_s * 1e6))

    @property
    @abstractmethod
    def trouble(self) -> str:
        """Why there is no face, in one line for its user; empty while there is one."""

    @abstractmethod
    def _read(self) -> None:
        """Take samples until it is closing."""

    def close(self) -> None:
        """Stop reading, and free what was taken; a reader that stands still is not waited for."""
        self._closing.set()
        self._thread.join(timeout=END_S)

    def preview(self) -> Image | None:
        """What a camera sees, uint8 ``[H, W, 3]``; None of other trackers."""
        return None

    def _push(self, sample: TrackerSample, arrived_s: float, began_s: float) -> None:
        """Take a sample; its making began at a moment."""
        with self._lock:
            self.face.push(sample, arrived_s)
        if self._tap is not None:
            self._tap(sample, arrived_s, time.monotonic() - began_s)
