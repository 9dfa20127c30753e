"""iFacialMocap and Facemotion3d: lines of text over UDP, asked for by a message to the phone.

    mouthSmile_R-0|...|eyeBlink_L-7|...|=head#rx,ry,rz,px,py,pz|rightEye#x,y,z|leftEye#x,y,z|

Values are whole numbers of 0 to 100, with ``-`` or ``&`` before them; sides are ``_L`` and ``_R``,
or ``Left`` and ``Right``; angles are degrees. The phone's request is sent again when it falls
silent. The head's rotation is pitch about +x, yaw about +y, roll about +z; its place is ARKit's,
metres, +x to the right of the camera, which is the subject's left, +y up, +z towards the camera.
Neither could be held against the apps themselves.
"""

import math
import re
from typing import Final

import numpy as np

from pica_client.playout.rotation import rotation_vector_from_yaw_pitch_roll
from pica_client.sources.live.sample import (
    VALUE_LIMIT,
    PacketError,
    TrackerSample,
    arkit_from_names,
)
from pica_core.types import FloatArray

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


def decode(packet: bytes) -> TrackerSample:
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
    values = {}
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
