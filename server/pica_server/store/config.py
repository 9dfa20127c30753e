"""How much an avatar store takes, and how fast it gives."""

from dataclasses import dataclass
from typing import Annotated

from pica_server.config.ranges import Range, check_ranges


@dataclass(frozen=True, kw_only=True, slots=True)
class StoreConfig:
    """Limits of the avatar store."""

    quota_bytes: Annotated[int, Range(1, 2**50)] = 256 * 2**20
    """Bytes of all files together; 4015 above it."""
    largest_bytes: Annotated[int, Range(1024, 64 * 2**20)] = 16 * 2**20
    """Bytes of one file; 4015 above it."""
    max_avatars: Annotated[int, Range(1, 1_000_000)] = 10_000
    """Files in the store; 4015 above it."""
    bytes_per_s: Annotated[float, Range(1024, 1e12)] = 16.0 * 2**20
    """Bytes a second of all transfers together, so that they do not delay the faces."""
    grace_s: Annotated[float, Range(0.01, 600)] = 10.0
    """Seconds that every transfer may take."""
    slowest_bytes_per_s: Annotated[float, Range(1, 1e9)] = 8192.0
    """A transfer that takes longer than that and its size at this rate is cut."""
    uploads: Annotated[int, Range(1, 10_000)] = 8
    """At once, each in memory until it is whole; one more is told to come later (4009)."""
    uploads_per_address: Annotated[int, Range(1, 10_000)] = 2
    """At once; this machine has no limit."""
    downloads: Annotated[int, Range(1, 100_000)] = 64
    """At once; one more is told to come later (HTTP 503)."""
    downloads_per_address: Annotated[int, Range(1, 100_000)] = 16
    """At once; this machine has no limit."""

    def __post_init__(self) -> None:
        check_ranges(self, "store.")

    def longest_s(self, size: int) -> float:
        """How long a transfer of `size` bytes may take."""
        return self.grace_s + size / self.slowest_bytes_per_s
