"""What a live tracker says of a face at one moment, whatever protocol it speaks."""

from dataclasses import dataclass, field

import numpy as np

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.types import FloatArray

VALUE_LIMIT = 4.0
"""Blendshape values beyond this are no face (chosen: real recordings reach 1.05)."""


class PacketError(Exception):
    """A datagram that is not what the tracker should send; says how to mend it, if that is
    known."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackerSample:
    """One sample of a live tracker.

    Attributes:
        tracker_s: When the face looked like this on the tracker's clock, seconds; None if the
            tracker does not say.
        arkit: Blendshape values in `ARKIT_NAMES` order; NaN where the tracker sends none. float32
            ``[52]``.
        rotation: Head rotation vector, radians, head frame. float32 ``[3]``.
        place_m: Where the head is before the tracker, metres, axes of a head that looks at it (+x
            the subject's left, +y up, +z towards the tracker); None if the tracker does not say.
            float32 ``[3]``.
        has_face: False while the tracker sees nobody.
        subject: Whose face it is, as the tracker calls it.
    """

    tracker_s: float | None = None
    arkit: FloatArray = field(default_factory=lambda: np.full(NUM_ARKIT, np.nan, np.float32))
    rotation: FloatArray = field(default_factory=lambda: np.zeros(3, np.float32))
    place_m: FloatArray | None = None
    has_face: bool = True
    subject: str = ""


def arkit_from_names(values: dict[str, float]) -> FloatArray:
    """Put values by ARKit name, in any case, into their order: float32 ``[52]``, NaN where no value
    was given. Names that ARKit does not have are left out."""
    arkit = np.full(NUM_ARKIT, np.nan, np.float32)
    for name, value in values.items():
        index = INDEX_BY_FOLDED_NAME.get(name.lower())
        if index is not None:
            arkit[index] = value
    return arkit


INDEX_BY_FOLDED_NAME = {name.lower(): index for name, index in ARKIT_INDEX.items()}
"""Place of each shape by its name in lower case."""
