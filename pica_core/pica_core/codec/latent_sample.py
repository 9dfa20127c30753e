"""One moment of a face as it travels: encoded, off the wire, decoded."""

from dataclasses import dataclass

from pica_core.types import FloatArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LatentSample:
    """A face at one moment: the latent and the pose of the head."""

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
    """A face with its place in the stream's time; fields as in `ReceivedFrame`."""

    number: int
    captured_us: int
    sample: LatentSample
    media_s: float = 0.0
    arrived_s: float = 0.0
    """When it could be decoded, on the receiver's clock, seconds."""


@dataclass(frozen=True, slots=True)
class ReceivedFrame:
    """A frame off the wire with its place in the stream's time, still to be decoded."""

    number: int
    """Counts the frames of the stream and never wraps. Where the sender began anew it leaps, so
    that nothing refers back across that place."""
    captured_us: int
    """Sender's clock as it was told, microseconds."""
    layer: int
    is_keyframe: bool
    payload: bytes
    media_s: float = 0.0
    """Capture time on the stream's own time line, seconds: the sender's clock, from an origin of
    the receiver's, with its jumps taken out."""
    arrived_s: float = 0.0
    """When it came, on the receiver's clock, seconds."""

    def decoded(self, sample: LatentSample, arrived_s: float | None = None) -> DecodedFrame:
        """The frame with its face; with `arrived_s` if it had to wait for what it refers to."""
        arrived_s = self.arrived_s if arrived_s is None else arrived_s
        return DecodedFrame(self.number, self.captured_us, sample, self.media_s, arrived_s)
