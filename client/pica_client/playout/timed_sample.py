"""A decoded frame with its place in the stream's time."""

from __future__ import annotations

from dataclasses import dataclass

from pica_core.codec.latent_sample import LatentSample


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TimedSample:
    """One frame of a stream, decoded, with its arrival."""

    sequence: int
    """As on the wire, 0 to 65535."""
    captured_us: int
    """Sender's clock as it was told, microseconds."""
    arrived_s: float
    """Our clock, seconds."""
    sample: LatentSample
    number: int
    """The sequence as a number that never wraps and goes on when the sender begins anew."""
    media_s: float
    """Capture time on the stream's own time line, seconds: the sender's clock, from an origin of
    ours, with its jumps taken out (`sender_time`)."""

    @property
    def captured_s(self) -> float:
        """Sender's clock, seconds."""
        return self.captured_us / 1e6
