"""The 52 ARKit blendshape names and one moment of a tracked face.

Order: Live Link Face's UDP order, which is ARKit's own order of `ARFaceAnchor.BlendShapeLocation`.
Files and trackers are always mapped by *name*; the order matters only inside this code base.
"""

from dataclasses import dataclass, field

import numpy as np

from pica_core.types import FloatArray

_PER_EYE = ("Blink", "LookDown", "LookIn", "LookOut", "LookUp", "Squint", "Wide")

ARKIT_NAMES: tuple[str, ...] = (
    *(f"eye{shape}{side}" for side in ("Left", "Right") for shape in _PER_EYE),
    *("jawForward", "jawLeft", "jawRight", "jawOpen"),
    *("mouthClose", "mouthFunnel", "mouthPucker", "mouthLeft", "mouthRight"),
    *("mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft", "mouthFrownRight"),
    *("mouthDimpleLeft", "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight"),
    *("mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper"),
    *("mouthPressLeft", "mouthPressRight", "mouthLowerDownLeft", "mouthLowerDownRight"),
    *("mouthUpperUpLeft", "mouthUpperUpRight"),
    *("browDownLeft", "browDownRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight"),
    *("cheekPuff", "cheekSquintLeft", "cheekSquintRight"),
    *("noseSneerLeft", "noseSneerRight", "tongueOut"),
)
NUM_ARKIT = 52
ARKIT_INDEX: dict[str, int] = {name: index for index, name in enumerate(ARKIT_NAMES)}
EYE_YAW, EYE_PITCH_UP, EYE_PITCH_DOWN = np.radians([35.0, 25.0, 28.0])
"""Gaze at a look shape of 1, radians."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ExpressionFrame:
    """One sample of a face tracker.

    Attributes:
        captured_us: When the face looked like this, on the sender's clock, integer microseconds.
        arkit: Blendshape values in `ARKIT_NAMES` order, about [0, 1]. float32 ``[52]``.
        rotation: Head rotation as a rotation vector (axis times angle, radians), head to seat.
            float32 ``[3]``.
        translation_m: Head offset from its seat in metres, seat axes. float32 ``[3]``.
        has_face: False while the tracker sees no face.
    """

    captured_us: int
    arkit: FloatArray
    rotation: FloatArray = field(default_factory=lambda: np.zeros(3, np.float32))
    translation_m: FloatArray = field(default_factory=lambda: np.zeros(3, np.float32))
    has_face: bool = True
