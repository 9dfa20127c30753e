"""The datagrams of trackers: Live Link Face, VMC, iFacialMocap and Facemotion3d.

VMC, the protocol of VTuber programs: OSC messages over UDP.

Blendshapes come one a message and hold from ``/VMC/Ext/Blend/Apply`` on. Perfect Sync gives them
ARKit's names, in any case; a plain VRM model has vowels, blinks and smiles, which are translated
into the shapes that do not come by their own name. Where Apply never comes, values hold as soon as
a name comes again.
Bones are Unity's, left-handed with the subject's left at -x: mirrored in x they are ours. Bones of
the eyes are the gaze of a model that has no ARKit shapes for it. Places of bones are offsets within
the model, and say nothing of where the head is.
"""

import logging
import math
import re
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pythonosc
from pythonosc.osc_packet import OscPacket

from pica_client.sources.live_face import (
    INDEX_BY_FOLDED_NAME,
    VALUE_LIMIT,
    PacketError,
    TrackerSample,
    arkit_from_names,
    rotation_vector_from_quaternion,
    rotation_vector_from_yaw_pitch_roll,
    turned,
)
from pica_core.avatar.arkit import EYE_PITCH_DOWN, EYE_PITCH_UP, EYE_YAW, NUM_ARKIT
from pica_core.types import FloatArray

LIVELINK_PORT: Final = 11111
VERSION: Final = 6
NUM_VALUES: Final = 61
METAHUMAN_BYTES: Final = 584
MAX_NAME_BYTES: Final = 256
"""Longest device id or subject (chosen: a device id is 36 bytes)."""
_TIME: Final = struct.Struct(">ifii")
_VALUES: Final = struct.Struct(f">{NUM_VALUES}f")


def decode_livelink(packet: bytes) -> TrackerSample:
    """Read one datagram.

    Raises:
        PacketError: It is of another form.
    """
    if len(packet) == METAHUMAN_BYTES:
        raise PacketError("the app sends MetaHuman data; switch it to Live Link (ARKit)")
    if packet[:1] != bytes([VERSION]):
        raise PacketError("not a Live Link Face datagram")
    place = _after_text(packet, _after_text(packet, 1))  # device and subject
    if len(packet) < place + _TIME.size:
        raise PacketError("cut in the frame's time")
    frame, sub_frame, numerator, denominator = _TIME.unpack_from(packet, place)
    place += _TIME.size
    has_time = numerator > 0 and denominator > 0 and math.isfinite(sub_frame)
    tracker_s = (frame + sub_frame) * denominator / numerator if has_time else None
    if len(packet) == place or packet[place] == 0:
        return TrackerSample(tracker_s=tracker_s, has_face=False)
    if packet[place] != NUM_VALUES:
        raise PacketError(f"{packet[place]} values instead of {NUM_VALUES}")
    if len(packet) != place + 1 + _VALUES.size:
        raise PacketError("cut in the values")
    values = np.array(_VALUES.unpack_from(packet, place + 1), np.float64)
    if not (np.abs(values) <= VALUE_LIMIT).all():
        raise PacketError(f"a value lies outside of ±{VALUE_LIMIT:g}")
    angles = values[None, NUM_ARKIT : NUM_ARKIT + 3]
    return TrackerSample(
        tracker_s=tracker_s,
        arkit=values[:NUM_ARKIT].astype(np.float32),
        rotation=rotation_vector_from_yaw_pitch_roll(angles)[0],
    )


def _after_text(packet: bytes, place: int) -> int:
    """The place behind a text with its length before it."""
    begin = place + 4
    length = int.from_bytes(packet[place:begin], "big", signed=True)
    if not 0 <= length <= MAX_NAME_BYTES or len(packet) < begin + length:
        raise PacketError("cut, or not a Live Link Face datagram")
    return begin + length


MAX_BYTES: Final = 8192
"""Longest line (chosen: the apps send about 1.5 kB)."""
FARTHEST_M: Final = 10.0
"""A head further from its phone is none, and has another unit."""
_ITEM: Final = re.compile(r"(\w+?)(_L|_R)?[&-](-?\d+(?:\.\d+)?)")
_SIDES: Final = {"_L": "Left", "_R": "Right"}


REQUESTS: Final = {
    "ifacialmocap": (49983, b"iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719"),
    "facemotion3d": (49993, b"FACEMOTION3D_OtherStreaming"),
}
"""What each app has: the phone's port, and ours, and what the phone waits for until it sends."""


def decode_ifacialmocap(packet: bytes) -> TrackerSample:
    """Read one datagram.

    Raises:
        PacketError: It is of another form.
    """
    if len(packet) > MAX_BYTES:
        raise PacketError("too long for a line of iFacialMocap")
    try:
        text = packet.decode("ascii")
    except UnicodeDecodeError as error:
        raise PacketError("not a line of iFacialMocap") from error
    shapes, equals, bones = text.partition("=")
    values: dict[str, float] = {}
    for item in filter(None, shapes.split("|")):
        found = _ITEM.fullmatch(item)
        if found is not None and not item.startswith("FM_"):
            name, value = found[1] + _SIDES.get(found[2], ""), float(found[3]) / 100
            if abs(value) > VALUE_LIMIT:
                raise PacketError(f"a value lies outside of ±{VALUE_LIMIT * 100:g}")
            values[name] = value
    arkit = arkit_from_names(values)
    if not equals or np.isnan(arkit).all():
        raise PacketError("not a line of iFacialMocap")
    if values.get("trackingStatus") == 0:  # the app repeats its last values
        return TrackerSample(has_face=False)
    rotation, place_m = _head(bones)
    return TrackerSample(arkit=arkit, rotation=rotation, place_m=place_m)


def _head(bones: str) -> tuple[FloatArray, FloatArray | None]:
    """Rotation vector and place of the head."""
    for bone in bones.split("|"):
        name, _, numbers = bone.partition("#")
        if name == "head":
            try:
                values = [float(each) for each in numbers.split(",")[:6]]
                pitch, yaw, roll = np.radians(values[:3])
            except ValueError as error:
                raise PacketError("a head without angles") from error
            if not all(abs(angle) <= 2 * math.pi for angle in (pitch, yaw, roll)):
                raise PacketError("a head that turns too far")
            turned: FloatArray = rotation_vector_from_yaw_pitch_roll(
                np.array([[yaw, pitch, roll]])
            )[0]
            place_m = np.array(values[3:], np.float32)
            is_place = len(place_m) == 3 and bool((np.abs(place_m) <= FARTHEST_M).all())
            return turned, place_m if is_place and place_m.any() else None
    return np.zeros(3, np.float32), None


# The library writes a line to the root logger for each damaged datagram, with what stood in it:
# any host that reaches the port could fill a log.
_LIBRARY: Final = str(Path(pythonosc.__file__).parent)
logging.getLogger().addFilter(lambda record: not record.pathname.startswith(_LIBRARY))

VMC_PORT: Final = 39539
_AA: Final = {"jawOpen": 0.7}
_EE: Final = {"jawOpen": 0.2, "mouthStretchLeft": 0.5, "mouthStretchRight": 0.5}
_IH: Final = {"jawOpen": 0.3, "mouthSmileLeft": 0.3, "mouthSmileRight": 0.3}
_OH: Final = {"jawOpen": 0.4, "mouthFunnel": 0.6}
_OU: Final = {"jawOpen": 0.15, "mouthPucker": 0.8}
_LEFT: Final = {"eyeBlinkLeft": 1.0}
_RIGHT: Final = {"eyeBlinkRight": 1.0}
_SMILE: Final = dict.fromkeys(("mouthSmileLeft", "mouthSmileRight"), 0.8)
VRM_SHAPES: Final[dict[str, dict[str, float]]] = {
    **{"a": _AA, "e": _EE, "i": _IH, "o": _OH, "u": _OU},
    **{"aa": _AA, "ee": _EE, "ih": _IH, "oh": _OH, "ou": _OU},
    **{"blink_l": _LEFT, "blinkleft": _LEFT, "blink_r": _RIGHT, "blinkright": _RIGHT},
    **{"blink": _LEFT | _RIGHT, "joy": _SMILE, "happy": _SMILE, "fun": _SMILE, "relaxed": _SMILE},
}
"""What a plain VRM expression at 1 is in ARKit's shapes, by its name in lower case; chosen by
eye."""
KNOWN_NAMES: Final = INDEX_BY_FOLDED_NAME.keys() | VRM_SHAPES.keys()
EYES: Final = {"LeftEye": ("Left", 1.0), "RightEye": ("Right", -1.0)}
"""Bones of the eyes: their shapes' side, and the sign of a turn outwards."""
BONES: Final = ("Head", "Neck", *EYES)


class VmcDecoder:
    """Gathers the messages of one sender until it says that they hold."""

    def __init__(self) -> None:
        self._values: dict[str, float] = {}
        self._turns: dict[str, FloatArray] = {}
        self._tracker_s: float | None = None
        self._has_applied = False
        self._round: set[str] = set()

    def decode(self, packet: bytes) -> list[TrackerSample]:
        """Read one datagram; a sample for each Apply in it, or each round of a sender without.

        Raises:
            PacketError: It is no OSC, or a value is none.
        """
        try:
            messages = [timed.message for timed in OscPacket(packet).messages]
        except Exception as error:  # the library raises what the bytes lead it to
            raise PacketError("not an OSC datagram") from error
        samples = []
        for message in messages:
            match message.address, message.params:
                case "/VMC/Ext/Blend/Val", [str(name), (float() | int()) as value, *_]:
                    if name in self._round and not self._has_applied:
                        samples.append(self._sample())
                    self._take_value(name, value)
                case "/VMC/Ext/Bone/Pos", [str(name), *numbers] if name in BONES:
                    self._turns[name] = _rotation(numbers)
                case "/VMC/Ext/T", [(float() | int()) as seconds, *_] if math.isfinite(seconds):
                    self._tracker_s = seconds
                case "/VMC/Ext/Blend/Apply", _:
                    self._has_applied = True
                    samples.append(self._sample())
                case _:
                    pass  # bones of the body, lights, cameras
        return samples

    def _take_value(self, name: str, value: float) -> None:
        if not abs(value) <= VALUE_LIMIT:
            raise PacketError(f"a value lies outside of ±{VALUE_LIMIT:g}")
        if (folded := name.lower()) in KNOWN_NAMES:  # so that no sender fills the memory
            self._values[folded] = value
            if not self._has_applied:
                self._round.add(name)

    def _sample(self) -> TrackerSample:
        self._round.clear()
        values = _from_vrm(self._values) | self._values
        if not any(name.startswith("eyelook") for name in values):
            values |= self._gaze()
        rotation = turned(self._turns.get("Head", _STILL), self._turns.get("Neck", _STILL))
        return TrackerSample(
            tracker_s=self._tracker_s, arkit=arkit_from_names(values), rotation=rotation
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
    """ARKit's shapes, in lower case, for a plain VRM model's expressions; what several move is
    added, up to 1."""
    mixed: dict[str, float] = {}
    for name, value in values.items():
        for shape, share in VRM_SHAPES.get(name, {}).items():
            mixed[shape.lower()] = min(mixed.get(shape.lower(), 0.0) + share * value, 1.0)
    return mixed


def _rotation(numbers: list[Any]) -> FloatArray:
    """The rotation vector of a bone: px py pz qx qy qz qw, mirrored in x."""
    if len(numbers) < 7 or not all(isinstance(each, float | int) for each in numbers[:7]):
        raise PacketError("a bone without seven numbers")
    x, y, z, w = numbers[3:7]
    length = math.hypot(x, y, z, w)
    if not 0.5 < length < 2:  # no unit quaternion, or none at all
        raise PacketError("a bone without a rotation")
    return rotation_vector_from_quaternion((w / length, x / length, -y / length, -z / length))


Decode = Callable[[bytes], Sequence[TrackerSample]]
"""Reads one datagram; raises `PacketError`."""


def decoder_of(kind: str) -> Decode:
    """Make a decoder for the datagrams of one sender, by the kind of tracker."""
    if kind == "vmc":
        return VmcDecoder().decode
    read = decode_livelink if kind == "livelink" else decode_ifacialmocap
    return lambda packet: (read(packet),)
