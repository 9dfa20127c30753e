"""How much an avatar store takes, and how fast it gives."""

from dataclasses import dataclass
from typing import Literal

from pica_server.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True, slots=True)
class StoreConfig:
    """Limits of the avatar store."""

    check: Literal["auto", "full", "structure"] = "auto"
    """What an upload must pass: full, all that receivers check, in a process of its own, which
    needs numpy here; structure, the layout of the file alone; auto, full where that can be."""
    quota_bytes: int = 256 * 2**20
    """Bytes of all files together; 4015 above it."""
    largest_bytes: int = 16 * 2**20
    """Bytes of one file; 4015 above it."""
    max_avatars: int = 10_000
    """Files in the store; 4015 above it."""
    bytes_per_s: float = 16.0 * 2**20
    """Bytes a second of all transfers together, so that they do not delay the faces."""
    grace_s: float = 10.0
    """Seconds that every transfer may take."""
    slowest_bytes_per_s: float = 8192.0
    """A transfer that takes longer than that and its size at this rate is cut."""
    uploads: int = 8
    """At once; one more is told to come later (4009)."""
    uploads_per_address: int = 2
    """At once; this machine has no limit."""
    downloads: int = 64
    """At once; one more is told to come later (HTTP 503)."""
    downloads_per_address: int = 16
    """At once; this machine has no limit."""

    def __post_init__(self) -> None:
        _check("quota-bytes", self.quota_bytes, 1, 2**50)
        _check("largest-bytes", self.largest_bytes, 1024, 64 * 2**20)
        _check("max-avatars", self.max_avatars, 1, 1_000_000)
        _check("bytes-per-s", self.bytes_per_s, 1024, 1e12)
        _check("grace-s", self.grace_s, 0.01, 600)
        _check("slowest-bytes-per-s", self.slowest_bytes_per_s, 1, 1e9)
        _check("uploads", self.uploads, 1, 10_000)
        _check("uploads-per-address", self.uploads_per_address, 1, 10_000)
        _check("downloads", self.downloads, 1, 100_000)
        _check("downloads-per-address", self.downloads_per_address, 1, 100_000)

    def longest_s(self, size: int) -> float:
        """How long a transfer of ``size`` bytes may take."""
        return self.grace_s + size / self.slowest_bytes_per_s


def _check(field: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ConfigurationError(f"--store.{field} must be in {low}..{high}, got {value}")
