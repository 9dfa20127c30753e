"""Live Link Face in ARKit mode: one UDP datagram a tracked frame, about 60 a second.

All numbers are big-endian:

    u8 version = 6 | i32 length, device id | i32 length, subject |
    i32 frame, f32 sub-frame, i32 rate numerator, i32 rate denominator |
    u8 count = 61 | 61 f32: the 52 shapes, head yaw, pitch, roll, and 3 angles of each eye, radians

A datagram that ends after the frame's time says that there is no face. The app's other mode, for
MetaHumans, sends 584 bytes of another form. Head angles are zero unless the app streams them.
"""

import math
import struct
from typing import Final

import numpy as np

from pica_client.playout.rotation import rotation_vector_from_yaw_pitch_roll
from pica_client.sources.live.sample import VALUE_LIMIT, PacketError, TrackerSample
from pica_core.avatar.arkit import NUM_ARKIT

DEFAULT_PORT: Final = 11111
VERSION: Final = 6
NUM_VALUES: Final = 61
METAHUMAN_BYTES: Final = 584
MAX_NAME_BYTES: Final = 256
"""Longest device id or subject (chosen: a device id is 36 bytes)."""
_TIME: Final = struct.Struct(">ifii")
_VALUES: Final = struct.Struct(f">{NUM_VALUES}f")


def decode(packet: bytes) -> TrackerSample:
    """Read one datagram.

    Raises:
        PacketError: It is of another form.
    """
    if len(packet) == METAHUMAN_BYTES:
        raise PacketError("the app sends MetaHuman data; switch it to Live Link (ARKit)")
    if packet[:1] != bytes([VERSION]):
        raise PacketError("not a Live Link Face datagram")
    _, place = _text(packet, 1)
    subject, place = _text(packet, place)
    if len(packet) < place + _TIME.size:
        raise PacketError("cut in the frame's time")
    frame, sub_frame, numerator, denominator = _TIME.unpack_from(packet, place)
    place += _TIME.size
    if numerator <= 0 or denominator <= 0 or not math.isfinite(sub_frame):
        raise PacketError("the frame's time is none")
    tracker_s = (frame + sub_frame) * denominator / numerator
    if len(packet) == place or packet[place] == 0:
        return TrackerSample(tracker_s=tracker_s, has_face=False, subject=subject)
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
        subject=subject,
    )


def _text(packet: bytes, place: int) -> tuple[str, int]:
    """A text with its length before it, and the place behind it."""
    begin = place + 4
    length = int.from_bytes(packet[place:begin], "big", signed=True)
    if not 0 <= length <= MAX_NAME_BYTES or len(packet) < begin + length:
        raise PacketError("cut, or not a Live Link Face datagram")
    return packet[begin : begin + length].decode("utf-8", "replace"), begin + length
