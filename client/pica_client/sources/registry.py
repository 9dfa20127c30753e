"""The text a user writes after ``--source``, and the source it stands for.

csv:FILE[@SECONDS]                    a recording of Live Link Face or `pica track --record`
performance:NAME[#SEED][@SECONDS]     a performance that ships with the package
voice, agent                          the voice alone moves the face; a silent agent keeps it
livelink, vmc, webcam, ...            trackers; see `open_live`
"""

import ipaddress
import math
from pathlib import Path
from typing import Final

import numpy as np

from pica_client.errors import SourceError
from pica_client.sources.calibration import Calibration, load_calibration
from pica_client.sources.datagrams import LIVELINK_PORT, REQUESTS, VMC_PORT
from pica_client.sources.live_face import VALUE_LIMIT, rotation_vector_from_yaw_pitch_roll
from pica_client.sources.source import (
    PERFORMANCES,
    Present,
    Recording,
    Source,
    Unseen,
    make_performance,
)
from pica_client.sources.tracker import ANY_HOST, LOOPBACK, SampleTap, Tracker, UdpTracker
from pica_client.system import say
from pica_core.errors import CaptureError, FaceNetworksError
from pica_core.livelink import DAY_S, TIMECODE_FPS, read_livelink_csv

LIVE_HELP: Final = (
    "livelink[:lan][:PORT], vmc[:lan][:PORT], ifacialmocap:PHONE_IP, "
    "facemotion3d:PHONE_IP or webcam[:DEVICE|FILE] for a face as it moves"
)
TRACKER_KINDS: Final = ("livelink", "vmc", *REQUESTS, "webcam")
"""All live sources."""


def open_live(
    kind: str, rest: str, calibration: Calibration | None = None, tap: SampleTap | None = None
) -> Tracker:
    """Begin to read a tracker.

    Args:
        kind: One of `TRACKER_KINDS`.
        rest: What the user wrote behind the kind, without the colon.
        tap: Sees what arrives.

    Raises:
        SourceError: The text is of another form, or the port, the camera or what it needs is not to
            be had; says what to do.
    """
    if kind == "webcam":
        # Only here: its networks need packages of their own.
        from pica_client.sources.webcam import Webcam
        from pica_core.face_networks import load_networks

        try:
            networks = load_networks()
        except FaceNetworksError as error:
            raise SourceError(f"webcam: {error}") from error
        return Webcam(rest, networks, calibration, tap)
    if kind in REQUESTS:
        try:
            phone = ipaddress.IPv4Address(rest)
        except ValueError:
            raise SourceError(
                f"{kind}:{rest} needs the phone's address, which the app shows: {kind}:192.168.0.7"
            ) from None
        # A program that plays the phone on this machine has the same port, at another address.
        host, port = LOOPBACK if phone.is_loopback else ANY_HOST, REQUESTS[kind][0]
        return UdpTracker(kind, port, calibration, tap, host=host, phone=str(phone))
    is_lan = rest == "lan" or rest.startswith("lan:")
    number = rest.removeprefix("lan").removeprefix(":") if is_lan else rest
    port = LIVELINK_PORT if kind == "livelink" else VMC_PORT
    if number and not (number.isdecimal() and int(number) < 65_536):
        raise SourceError(f"{kind}:{rest}: {number!r} is no port; write {kind}:{port}")
    host = ANY_HOST if is_lan else LOOPBACK
    return UdpTracker(kind, int(number) if number else port, calibration, tap, host=host)


SOURCE_HELP = (
    "csv:FILE[@SECONDS] for a recording of Live Link Face or pica track, "
    f"{LIVE_HELP}, voice for a mouth that follows your voice, or "
    "performance:NAME[#SEED][@SECONDS] with NAME one of " + ", ".join(PERFORMANCES)
)


def open_source(text: str, person: str = "") -> Source:
    """Open the source that a text describes; a tracker listens from then on until it is closed.

    Args:
        person: Whose calibration a tracker's samples are given, if there is one.

    Raises:
        SourceError: The text is not of a known form, or what it names cannot be read.
    """
    if text in ("voice", "agent"):
        return Unseen() if text == "voice" else Present()
    kind, rest = split_source(text)
    if kind in TRACKER_KINDS:
        return open_live(kind, rest, load_calibration(person, kind) if person else None)
    name, start_s = _split_start(rest, text)
    if not rest or kind not in ("csv", "performance"):
        raise SourceError(f"source {text!r} is unknown; write {SOURCE_HELP}")
    if kind == "csv":
        return load_livelink_csv(Path(name).expanduser(), start_s=start_s)
    name, mark, seed = name.partition("#")
    if mark and not seed.isdecimal():
        raise SourceError(f"performance seed {seed!r} is not a number; write performance:NAME#7")
    return make_performance(name, seed=int(seed) if mark else 0, start_s=start_s)


def split_source(text: str) -> tuple[str, str]:
    """The kind of a source, and what stands behind it."""
    kind, _, rest = text.partition(":")
    return kind, rest


def start_later(text: str, seconds: float) -> str:
    """The same source, begun some seconds further on."""
    rest, start_s = _split_start(text, text)
    return f"{rest}@{start_s + seconds:g}"


def _split_start(rest: str, text: str) -> tuple[str, float]:
    """Cut ``@SECONDS`` off the end, if it is there; a path may hold an @ of its own."""
    name, at, tail = rest.rpartition("@")
    if not at:
        return rest, 0.0
    try:
        start_s = float(tail)
    except ValueError:
        return rest, 0.0
    if not 0 <= start_s < math.inf:
        raise SourceError(f"source {text!r}: the start is {tail} s; 0 or more is allowed")
    return name, start_s


def load_livelink_csv(path: Path, *, start_s: float = 0.0) -> Recording:
    """Read a Live Link Face recording, at its own clock.

    Head angles are radians about the head's own axes (+x the subject's left, +y up, +z out of the
    face). That yaw turns about +y, pitch about +x and roll about +z, right-handed and in this order
    from the outside in, is our assumption: the recordings we have were made with head tracking off.

    Args:
        path: The ``.csv`` file of a take.
        start_s: Where in the recording the source begins, seconds.

    Returns:
        The looping recording. Lines without a face are moments without one, and so are those with
        values that are no numbers; of the latter the user is told.

    Raises:
        SourceError: It cannot be read, time runs backwards, or there is never a face.
    """
    try:
        take = read_livelink_csv(path)
    except CaptureError as error:
        raise SourceError(str(error)) from error
    count = len(take.clock_s)
    if take.num_lost:
        say(f"{path}: {take.num_lost} of {count} frames are lost, they hold NaN or infinity")
    if not take.has_face.any():
        raise SourceError(f"{path}: no frame holds a face and numbers alone; record the take again")
    beyond = np.abs(np.concatenate((take.arkit, take.angles), axis=1)).max(axis=1) > VALUE_LIMIT
    if beyond.any():
        line = int(np.argmax(beyond)) + 2
        raise SourceError(f"{path}, line {line}: a value lies outside ±{VALUE_LIMIT:g}")
    steps_s = np.diff(take.clock_s)
    steps_s[steps_s < -DAY_S / 2] += DAY_S  # past midnight
    if np.any(steps_s <= 0):
        line = int(np.argmax(steps_s <= 0)) + 3
        raise SourceError(f"{path}, line {line}: its timecode does not come after the line before")
    return Recording(
        times_s=np.concatenate(([0.0], np.cumsum(steps_s))),
        arkit=take.arkit.astype(np.float32),
        rotation=rotation_vector_from_yaw_pitch_roll(take.angles),
        translation_m=np.zeros((count, 3), np.float32),
        has_face=take.has_face,
        loop_gap_s=float(np.median(steps_s)) if len(steps_s) else 2 / TIMECODE_FPS,
        start_s=start_s,
    )
