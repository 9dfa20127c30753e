"""What a sender makes of a face on its way: values, as each step of a live call leaves them.

    driver        the values as they are, to the expression encoder
    codec         the same, through the latent stream at its usual quality
    live          the values as a tracker sends them 60 times a second, through smoothing and
                  resampling, then the stream
    offset        the same of a person whose squint and smile are `OFFSET` at rest and whose lids
                  go from `LIDS[0]` to `LIDS[1]`
    calibrated    the same person after `pica calibrate`

A live face is looked at for the moment at which it was seen, so what is left is what smoothing does
to it; how much later it is shown is no error here, but for the least way of a sample, 4 ms, which
is not observable. The tracker itself is perfect but for the offset, which is added to what the face
does.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from pica_client.bench.codec import FPS, code_stream
from pica_client.sources import Source
from pica_client.sources.live.calibration import BLINKS, Calibration, calibrate
from pica_client.sources.live.live_face import LiveFace, TrackerSample
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.codec.latent_stream import LatentSample, StreamConfig
from pica_core.types import FloatArray

TRACKER_FPS: Final = 60
ARRIVES_AFTER_S: Final = (0.004, 0.012)
"""Shortest and longest way of a sample to us, seconds, in turn."""
OFFSET: Final = 0.2
"""What squint and smile of the offset person are at rest."""
LIDS: Final = (0.1, 0.8)
"""Blink of the offset person with open and with closed eyes."""
_OFFSET_SHAPES: Final = [
    ARKIT_INDEX[f"{name}{side}"]
    for name in ("eyeSquint", "mouthSmile")
    for side in ("Left", "Right")
]
Person = Callable[[FloatArray], FloatArray]
"""What a tracker says of a face ``[52]``."""


def as_offset_person(arkit: FloatArray) -> FloatArray:
    """What a tracker says of the offset person. float32 ``[52]`` both."""
    said = arkit.copy()
    said[_OFFSET_SHAPES] = np.minimum(said[_OFFSET_SHAPES] + OFFSET, 1.0)
    said[list(BLINKS)] = LIDS[0] + (LIDS[1] - LIDS[0]) * said[list(BLINKS)]
    return said


def calibration_of(person: Person) -> Calibration:
    """What `pica calibrate` learns of a person."""
    rest, closed = np.zeros((2, NUM_ARKIT), np.float32)
    closed[list(BLINKS)] = 1.0
    return calibrate([person(rest)], [person(closed)])


def live_values(
    look: Callable[[float], TrackerSample],
    num_frames: int,
    calibration: Calibration | None,
) -> FloatArray:
    """A face as a live sender has it, for the moments of `FPS`.

    Args:
        look: What the tracker says of a moment, seconds; asked in order.

    Returns:
        float32 ``[T, 52]``; row t is the face as it was seen at t / `FPS` seconds.
    """
    face, pushed = LiveFace(calibration), 0
    values = []
    for number in range(num_frames):
        # Asked at the moment at which the face of this frame's time is shown.
        while True:
            now = number / FPS + face.delay_s
            way_s = ARRIVES_AFTER_S[pushed % len(ARRIVES_AFTER_S)]
            if pushed / TRACKER_FPS + way_s > now and pushed:
                break
            face.push(look(pushed / TRACKER_FPS), pushed / TRACKER_FPS + way_s)
            pushed += 1
        values.append(face.face_at(now).arkit)
    return np.stack(values)


def perfect_tracker(source: Source, person: Person) -> Callable[[float], TrackerSample]:
    """A tracker that says what a source does, as it would of a person."""

    def look(seen_s: float) -> TrackerSample:
        frame = source.frame_at(seen_s)
        arkit = person(frame.arkit)
        return TrackerSample(tracker_s=seen_s, arkit=arkit, has_face=frame.has_face)

    return look


def values_of(source: Source, num_frames: int) -> FloatArray:
    """What a source does at the moments of `FPS`. float32 ``[T, 52]``."""
    return np.stack([source.frame_at(number / FPS).arkit for number in range(num_frames)])


def shown_latents(avatar: Avatar, arkit: FloatArray, *, coded: bool) -> FloatArray:
    """What a receiver decodes of values.

    Args:
        arkit: One row a frame. float32 ``[T, 52]``.
        coded: Through the avatar's latent stream.

    Returns:
        float32 ``[T, 8, 8, 4]``.

    Raises:
        ProfileError: The avatar has no stream profile.
    """
    latents = ExpressionEncoder(avatar).encode(arkit)
    if not coded:
        return latents
    profile = avatar.stream_profile()
    still = np.zeros(3, np.float32)
    samples = [LatentSample(latent=each, rotation=still, translation_m=still) for each in latents]
    coded_stream = code_stream(profile, StreamConfig(fps=FPS), samples)
    return np.stack([sample.latent for sample in coded_stream.shown])


STAGES: Final = ("driver", "codec", "live", "offset", "calibrated")


def stage_values(stage: str, source: Source, num_frames: int) -> FloatArray:
    """The values that a stage hands to the expression encoder. float32 ``[T, 52]``."""
    if stage in ("driver", "codec"):
        return values_of(source, num_frames)
    person = np.copy if stage == "live" else as_offset_person
    calibration = calibration_of(person) if stage == "calibrated" else None
    return live_values(perfect_tracker(source, person), num_frames, calibration)
