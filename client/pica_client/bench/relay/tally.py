"""What came of the frames captured between two moments, as the peers of one process count it."""

import time
from collections import Counter
from typing import Any, Final

STEP_US: Final = 10
"""Width of the latency buckets."""
NUM_STEPS: Final = 200_000
"""Latencies up to 2 s; later frames count as that late."""


class Tally:
    """Counts frames, packets of voices, bytes and closed connections.

    Attributes:
        now_us: When the last read was.
        codes: Websocket close codes of connections that the relay ended; kept over all windows.
    """

    def __init__(self) -> None:
        self.codes: Counter[int] = Counter()
        self.begin(0, 0)

    def begin(self, begin_us: int, end_us: int) -> None:
        """Count frames captured from one moment to another, and forget what was counted before."""
        self.begin_us, self.end_us = begin_us, end_us
        self.sent = self.num_received = self.blocked = 0
        self.voices_sent = self.voices_received = 0
        self.bytes_in = self.reads = 0
        self.latencies = [0] * NUM_STEPS
        self.voice_latencies = [0] * NUM_STEPS
        self.turns = [0] * NUM_STEPS
        self.now_us = 0

    def covers(self, captured_us: int) -> bool:
        """Whether what was captured then counts."""
        return self.begin_us <= captured_us < self.end_us

    def received(self, captured_us: int) -> None:
        """Count one frame as of the last read."""
        if self.covers(captured_us):
            self.num_received += 1
            add_step(self.latencies, self.now_us - captured_us)

    def received_voice(self, captured_us: int) -> None:
        """Count one packet of a voice as of the last read."""
        if self.covers(captured_us):
            self.voices_received += 1
            add_step(self.voice_latencies, self.now_us - captured_us)

    def heard(self, num_bytes: int) -> None:
        """Count the bytes of one read."""
        self.bytes_in += num_bytes
        self.reads += 1
        self.now_us = time.monotonic_ns() // 1000

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON: of the buckets only those with something in them."""
        return {
            "sent": self.sent,
            "blocked": self.blocked,
            "received": self.num_received,
            "voices_sent": self.voices_sent,
            "voices_received": self.voices_received,
            "voice_latency": _filled(self.voice_latencies),
            "bytes_in": self.bytes_in,
            "reads": self.reads,
            "latency": _filled(self.latencies),
            "turn": _filled(self.turns),
        }


def add_step(buckets: list[int], duration_us: int) -> None:
    """Count a duration in its bucket."""
    buckets[min(duration_us // STEP_US, NUM_STEPS - 1)] += 1


def _filled(buckets: list[int]) -> dict[int, int]:
    return {step: count for step, count in enumerate(buckets) if count}
