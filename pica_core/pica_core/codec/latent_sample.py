"""One moment of a face as it travels: the latent and the pose of the head."""

from __future__ import annotations

from dataclasses import dataclass

from pica_core.types import FloatArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LatentSample:
    """A decoded frame of a latent stream."""

    latent: FloatArray
    """float32 ``[8, 8, 4]``."""
    rotation: FloatArray
    """Head to seat, rotation vector, radians. float32 ``[3]``."""
    translation_m: FloatArray
    """Head offset from its seat, metres. float32 ``[3]``."""
    is_still: bool = False
    """Whether the sender says that nothing changes until its next frame: a silence that follows is
    no gap, and ends one frame interval before the next frame."""


@dataclass(frozen=True, slots=True)
class EncodedFrame:
    """What goes onto the wire for one moment."""

    payload: bytes
    layer: int = 0
    """Temporal layer; no frame refers to one of a higher layer."""
    is_keyframe: bool = True
    """Whether it can be decoded alone."""


@dataclass(frozen=True, slots=True, eq=False)
class DecodedFrame:
    """What came out of one frame of the wire."""

    sequence: int
    """As on the wire, 0 to 65535."""
    captured_us: int
    """Sender's clock, microseconds."""
    layer: int
    sample: LatentSample
