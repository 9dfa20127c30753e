"""The VMC protocol of VTuber programs: OSC messages over UDP.

Blendshapes come one a message and hold from ``/VMC/Ext/Blend/Apply`` on. Perfect Sync gives them
ARKit's names, in any case; a plain VRM model has vowels, blinks and moods, which are translated.
Bones are Unity's, left-handed with the subject's left at -x: mirrored in x they are ours. Bones of
the eyes are the gaze of a model that has no ARKit shapes for it. Places of bones are offsets within
the model, and say nothing of where the head is.
"""

import logging
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import pythonosc
from pythonosc.osc_packet import OscPacket

from pica_client.playout.rotation import rotation_vector_from_quaternion, turned
from pica_client.sources.live import sample
from pica_core.capture.rig.gaze import EYE_PITCH_DOWN, EYE_PITCH_UP, EYE_YAW
from pica_core.types import FloatArray

# The library writes a line to the root logger for each damaged datagram, with what stood in it:
# whoever can reach the port could fill a log.
_LIBRARY: Final = str(Path(pythonosc.__file__).parent)
logging.getLogger().addFilter(lambda record: not record.pathname.startswith(_LIBRARY))

DEFAULT_PORT: Final = 39539
_AA: Final = {"jawOpen": 0.7}
_EE: Final = {"jawOpen": 0.2, "mouthStretchLeft": 0.5, "mouthStretchRight": 0.5}
_IH: Final = {"jawOpen": 0.3, "mouthSmileLeft": 0.3, "mouthSmileRight": 0.3}
_OH: Final = {"jawOpen": 0.4, "mouthFunnel": 0.6}
_OU: Final = {"jawOpen": 0.15, "mouthPucker": 0.8}
_LEFT: Final = {"eyeBlinkLeft": 1.0}
_RIGHT: Final = {"eyeBlinkRight": 1.0}
_JOY: Final = {
    **dict.fromkeys(("mouthSmileLeft", "mouthSmileRight"), 0.9),
    **dict.fromkeys(("cheekSquintLeft", "cheekSquintRight"), 0.6),
}
_ANGRY: Final = {
    **dict.fromkeys(("browDownLeft", "browDownRight"), 0.8),
    **dict.fromkeys(("mouthPressLeft", "mouthPressRight"), 0.3),
}
_SORROW: Final = {
    "browInnerUp": 0.8,
    **dict.fromkeys(("mouthFrownLeft", "mouthFrownRight"), 0.6),
}
_FUN: Final = dict.fromkeys(("mouthSmileLeft", "mouthSmileRight"), 0.6)
VRM_SHAPES: Final[dict[str, dict[str, float]]] = {
    **{"a": _AA, "e": _EE, "i": _IH, "o": _OH, "u": _OU},
    **{"aa": _AA, "ee": _EE, "ih": _IH, "oh": _OH, "ou": _OU},
    **{"blink_l": _LEFT, "blinkleft": _LEFT, "blink_r": _RIGHT, "blinkright": _RIGHT},
    **{"blink": _LEFT | _RIGHT, "joy": _JOY, "happy": _JOY, "angry": _ANGRY},
    **{"sorrow": _SORROW, "sad": _SORROW, "fun": _FUN, "relaxed": _FUN},
}
"""What a plain VRM expression at 1 is in ARKit's shapes, by its name in lower case; chosen by
eye."""
KNOWN_NAMES: Final = sample.INDEX_BY_FOLDED_NAME.keys() | VRM_SHAPES.keys()
EYES: Final = {"LeftEye": ("Left", 1.0), "RightEye": ("Right", -1.0)}
"""Bones of the eyes: their shapes' side, and the sign of a turn outwards."""
BONES: Final = ("Head", "Neck", *EYES)


class VmcDecoder:
    """Gathers the messages of one sender until it says that they hold."""

    def __init__(self) -> None:
        self._values: dict[str, float] = {}
        self._turns: dict[str, FloatArray] = {}
        self._tracker_s: float | None = None

    def decode(self, packet: bytes) -> list[sample.TrackerSample]:
        """Read one datagram; a sample for each Apply in it.

        Raises:
            PacketError: It is no OSC, or a value is none.
        """
        try:
            messages = [timed.message for timed in OscPacket(packet).messages]
        except Exception as error:  # the library raises what the bytes lead it to
            raise sample.PacketError("not an OSC datagram") from error
        samples = []
        for message in messages:
            match message.address, message.params:
                case "/VMC/Ext/Blend/Val", [str(name), float(value), *_]:
                    self._take_value(name, value)
                case "/VMC/Ext/Bone/Pos", [str(name), *numbers] if name in BONES:
                    self._turns[name] = _rotation(numbers)
                case "/VMC/Ext/T", [float(seconds), *_] if math.isfinite(seconds):
                    self._tracker_s = seconds
                case "/VMC/Ext/Blend/Apply", _:
                    samples.append(self._sample())
                case _:
                    pass  # bones of the body, lights, cameras
        return samples

    def _take_value(self, name: str, value: float) -> None:
        if not abs(value) <= sample.VALUE_LIMIT:
            raise sample.PacketError(f"a value lies outside of ±{sample.VALUE_LIMIT:g}")
        if (folded := name.lower()) in KNOWN_NAMES:  # so that no sender fills the memory
            self._values[folded] = value

    def _sample(self) -> sample.TrackerSample:
        values = dict(self._values)
        if sample.INDEX_BY_FOLDED_NAME.keys().isdisjoint(values):
            values = _from_vrm(values)
        if not any(name.startswith("eyelook") for name in values):
            values |= self._gaze()
        rotation = turned(self._turns.get("Head", _STILL), self._turns.get("Neck", _STILL))
        return sample.TrackerSample(
            tracker_s=self._tracker_s, arkit=sample.arkit_from_names(values), rotation=rotation
        )

    def _gaze(self) -> dict[str, float]:
        """ARKit's look shapes of the eyes' bones, as far as there are such."""
        shapes: dict[str, float] = {}
        for bone, (side, outwards) in EYES.items():
            if bone in self._turns:
                down, left, _ = self._turns[bone].tolist()
                out = outwards * left / EYE_YAW
                shapes |= {
                    f"eyeLookOut{side}": max(out, 0.0),
                    f"eyeLookIn{side}": max(-out, 0.0),
                    f"eyeLookUp{side}": max(-down / EYE_PITCH_UP, 0.0),
                    f"eyeLookDown{side}": max(down / EYE_PITCH_DOWN, 0.0),
                }
        return {name: min(value, 1.0) for name, value in shapes.items()}


_STILL: Final[FloatArray] = np.zeros(3, np.float32)


def _from_vrm(values: dict[str, float]) -> dict[str, float]:
    """ARKit's shapes for a plain VRM model's expressions; what several move is added, up to 1."""
    mixed: dict[str, float] = {}
    for name, value in values.items():
        for shape, share in VRM_SHAPES.get(name, {}).items():
            mixed[shape] = min(mixed.get(shape, 0.0) + share * value, 1.0)
    return mixed


def _rotation(numbers: list[Any]) -> FloatArray:
    """The rotation vector of a bone: px py pz qx qy qz qw, mirrored in x."""
    if len(numbers) < 7 or not all(isinstance(each, float) for each in numbers[:7]):
        raise sample.PacketError("a bone without seven numbers")
    x, y, z, w = numbers[3:7]
    length = math.hypot(x, y, z, w)
    if not 0.5 < length < 2:  # no unit quaternion, or none at all
        raise sample.PacketError("a bone without a rotation")
    return rotation_vector_from_quaternion((w / length, x / length, -y / length, -z / length))
