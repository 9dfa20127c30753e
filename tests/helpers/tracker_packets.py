"""Trackers as their specifications have them: datagrams built without the code under test."""

import struct
from collections.abc import Mapping, Sequence

LIVE_LINK_ORDER = (
    *(
        f"Eye{shape}{side}"
        for side in ("Left", "Right")
        for shape in ("Blink", "LookDown", "LookIn", "LookOut", "LookUp", "Squint", "Wide")
    ),
    *("JawForward", "JawLeft", "JawRight", "JawOpen", "MouthClose", "MouthFunnel"),
    *("MouthPucker", "MouthLeft", "MouthRight", "MouthSmileLeft", "MouthSmileRight"),
    *("MouthFrownLeft", "MouthFrownRight", "MouthDimpleLeft", "MouthDimpleRight"),
    *("MouthStretchLeft", "MouthStretchRight", "MouthRollLower", "MouthRollUpper"),
    *("MouthShrugLower", "MouthShrugUpper", "MouthPressLeft", "MouthPressRight"),
    *("MouthLowerDownLeft", "MouthLowerDownRight", "MouthUpperUpLeft", "MouthUpperUpRight"),
    *("BrowDownLeft", "BrowDownRight", "BrowInnerUp", "BrowOuterUpLeft", "BrowOuterUpRight"),
    *("CheekPuff", "CheekSquintLeft", "CheekSquintRight", "NoseSneerLeft", "NoseSneerRight"),
    *("TongueOut", "HeadYaw", "HeadPitch", "HeadRoll", "LeftEyeYaw", "LeftEyePitch"),
    *("LeftEyeRoll", "RightEyeYaw", "RightEyePitch", "RightEyeRoll"),
)


def live_link(
    values: Mapping[str, float] | None,
    *,
    frame: int = 0,
    sub_frame: float = 0.0,
    rate: tuple[int, int] = (60, 1),
) -> bytes:
    """A datagram of Live Link Face; None for the values: no face."""
    packet = struct.pack(">B", 6)
    for text in ("5F0C6C0B-6F3C-4F52-9E43-3F3B2C9D4E11", "iPhone"):
        packet += struct.pack(">i", len(text.encode())) + text.encode()
    packet += struct.pack(">ifii", frame, sub_frame, *rate)
    if values is None:
        return packet
    assert set(values) <= set(LIVE_LINK_ORDER)
    ordered = [values.get(name, 0.0) for name in LIVE_LINK_ORDER]
    return packet + struct.pack(">B61f", 61, *ordered)


def osc(address: str, *arguments: str | float | int) -> bytes:
    """An OSC message."""

    def padded(text: str) -> bytes:
        raw = text.encode() + b"\0"
        return raw + b"\0" * (-len(raw) % 4)

    tags, body = ",", b""
    for argument in arguments:
        if isinstance(argument, str):
            tags, body = tags + "s", body + padded(argument)
        elif isinstance(argument, int):
            tags, body = tags + "i", body + struct.pack(">i", argument)
        else:
            tags, body = tags + "f", body + struct.pack(">f", argument)
    return padded(address) + padded(tags) + body


def osc_bundle(messages: Sequence[bytes]) -> bytes:
    """An OSC bundle that holds at once."""
    parts = b"".join(struct.pack(">i", len(each)) + each for each in messages)
    return b"#bundle\0" + struct.pack(">Q", 1) + parts


def vmc(
    values: Mapping[str, float],
    *,
    seconds: float | None = None,
    bones: Mapping[str, tuple[float, float, float, float]] | None = None,
) -> bytes:
    """A bundle of VMC: one sample that holds; whole numbers go as OSC's integers."""
    messages = [] if seconds is None else [osc("/VMC/Ext/T", seconds)]
    for bone, (x, y, z, w) in (bones or {}).items():
        numbers = (0.0, 0.0, 0.0, x, y, z, w)
        messages.append(osc("/VMC/Ext/Bone/Pos", bone, *numbers))
    messages += [osc("/VMC/Ext/Blend/Val", name, value) for name, value in values.items()]
    return osc_bundle([*messages, osc("/VMC/Ext/Blend/Apply")])


def ifacialmocap(
    values: Mapping[str, int], head: Sequence[float] = (0.0,) * 6, separator: str = "-"
) -> bytes:
    """A line of iFacialMocap, values in hundredths."""
    shapes = "".join(f"{name}{separator}{value}|" for name, value in values.items())
    angles = ",".join(f"{each:g}" for each in head)
    return f"{shapes}=head#{angles}|rightEye#0,0,0|leftEye#0,0,0|".encode()
