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
    """What goes onto the wire for one moment; it is decoded alone."""

    payload: bytes
    multiple: int = 1
    """Its sequence number is to be a multiple of this: receivers may ask for every second or fourth
    number."""


@dataclass(frozen=True, slots=True, eq=False)
class DecodedFrame:
    """A face with its place in the stream's time; fields as in `ReceivedFrame`."""

    number: int
    captured_us: int
    sample: LatentSample
    media_s: float = 0.0
    arrived_s: float = 0.0
    """When it came, on the receiver's clock, seconds."""


@dataclass(frozen=True, slots=True)
class ReceivedFrame:
    """A frame off the wire with its place in the stream's time, still to be decoded."""

    number: int
    """Counts the frames of the stream and never wraps; it leaps where the sender began again."""
    captured_us: int
    """Sender's clock as it was told, microseconds."""
    payload: bytes
    media_s: float = 0.0
    """Capture time on the stream's own time line, seconds: the sender's clock, from an origin of
    the receiver's, with its jumps taken out."""
    arrived_s: float = 0.0
    """When it came, on the receiver's clock, seconds."""

    def decoded(self, sample: LatentSample) -> DecodedFrame:
        """The frame with its face."""
        return DecodedFrame(self.number, self.captured_us, sample, self.media_s, self.arrived_s)
