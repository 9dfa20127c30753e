"""A small latent stream for tests: faces that move on twelve shapes, made from seeds."""

import functools
from dataclasses import dataclass

import numpy as np

from helpers.toy import make_toy_avatar
from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.codec.latent_stream import (
    DEFAULT_QUALITY,
    LatentDecoder,
    LatentEncoder,
    LatentSample,
)
from pica_core.types import Float64Array

NUM_MOVING = 12
STILL = np.zeros(3)


def toy_faces(seed: int, num_frames: int) -> Float64Array:
    """ARKit values of a face that talks, blinks and rests. ``[T, 52]``."""
    rng = np.random.default_rng([seed, 77])
    times_s = np.arange(num_frames)[:, None] / 30
    moving = np.zeros((num_frames, NUM_MOVING))
    for period_s in (3.1, 1.3, 0.45):
        phase = rng.uniform(0, 2 * np.pi, (1, NUM_MOVING))
        moving += rng.uniform(0, 0.2, (1, NUM_MOVING)) * np.sin(
            2 * np.pi * times_s / period_s + phase
        )
    blinks = rng.random(num_frames) < 0.02
    moving[:, 0] += np.convolve(blinks, [0.6, 1.0, 0.7, 0.3])[:num_frames]
    talks = np.repeat(rng.random(num_frames // 60 + 1) < 0.8, 60)[:num_frames, None]
    frame = np.cumsum(talks, axis=0)[:, 0] - 1  # at rest the face stays where it is
    faces = np.full((num_frames, NUM_ARKIT), 0.02)
    faces[:, rng.permutation(NUM_ARKIT)[:NUM_MOVING]] += moving[np.maximum(frame, 0)]
    return np.clip(faces, 0, 1)


def toy_pose(seed: int, num_frames: int) -> Float64Array:
    """A head that nods and sways: rotation and translation. ``[T, 2, 3]``."""
    rng = np.random.default_rng([seed, 78])
    times_s = np.arange(num_frames)[:, None, None] / 30
    phase = rng.uniform(0, 2 * np.pi, (1, 2, 3))
    reach = np.array([[0.1], [0.01]])
    pose: Float64Array = reach * np.sin(2 * np.pi * times_s / rng.uniform(1, 4, (1, 2, 3)) + phase)
    return pose


@functools.cache
def toy_decoder() -> LatentDecoder:
    """Of the toy avatar."""
    return LatentDecoder(make_toy_avatar())


@dataclass(frozen=True, kw_only=True, slots=True)
class Sent:
    """A frame on the wire."""

    number: int
    """Counts the frames."""
    captured_us: int
    multiple: int
    payload: bytes

    def decoded(self) -> LatentSample:
        """What a receiver makes of it."""
        return toy_decoder().decode(self.payload)


class Publisher:
    """An encoder with what it sent."""

    def __init__(self, *, quality: int = DEFAULT_QUALITY) -> None:
        self.encoder = LatentEncoder(quality=quality)
        self.sent: list[Sent] = []

    def show(self, face: Float64Array, pose: Float64Array, now_us: int) -> Sent | None:
        """Encode one face; None when there was nothing to send."""
        frame = self.encoder.encode(face, pose[0], pose[1], now_us)
        if frame is None:
            return None
        number = self.sent[-1].number + 1 if self.sent else 0
        number += -number % frame.multiple
        self.sent.append(
            Sent(number=number, captured_us=now_us, multiple=frame.multiple, payload=frame.payload)
        )
        return self.sent[-1]

    def show_all(self, faces: Float64Array, poses: Float64Array) -> list[Sent]:
        """Encode a performance, going on in time after what was sent before."""
        begin_us = self.sent[-1].captured_us + 33_333 if self.sent else 0
        before = len(self.sent)
        for index, (face, pose) in enumerate(zip(faces, poses, strict=True)):
            self.show(face, pose, begin_us + round(index * 1e6 / 30))
        return self.sent[before:]


def perform(seed: int = 1, num_frames: int = 120) -> list[Sent]:
    """The frames of a performance."""
    return Publisher().show_all(toy_faces(seed, num_frames), toy_pose(seed, num_frames))
