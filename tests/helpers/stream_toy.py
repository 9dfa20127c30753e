"""A small latent stream for tests: faces that move on eight muscles, and the profile learned from
them.

Everything is made from seeds. The metric says that a change along any of twelve directions shows in
the picture as much as such changes do in the shipped avatars, so coefficients, bits and silences
look like those of a real stream, at a tenth of the cost.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from helpers.toy import make_toy_avatar
from pica_core.avatar.file import Avatar
from pica_core.codec.latent_stream import (
    DEFAULT_QUALITY,
    LatentDecoder,
    LatentEncoder,
    LatentSample,
)
from pica_core.codec.profile import StreamProfile
from pica_core.train.stream_learning import RenderMetric, learn_profile
from pica_core.types import Float64Array

NUM_DIRECTIONS = 12
NUM_COMPONENTS = 8
STILL = np.zeros(3)


@functools.cache
def toy_metric() -> RenderMetric:
    """Twelve directions, the first of which shows sixteen times as much as the last."""
    random = np.random.default_rng(5).standard_normal((256, NUM_DIRECTIONS))
    directions = np.linalg.qr(random)[0].T
    return RenderMetric(directions, np.diag(np.geomspace(4.0, 0.25, NUM_DIRECTIONS) ** 2))


def toy_faces(seed: int, num_frames: int, liveliness: float = 1.0) -> Float64Array:
    """Latents of a face that talks, blinks and rests. ``[T, 8, 8, 4]``."""
    rng = np.random.default_rng([seed, 77])
    times_s = np.arange(num_frames)[:, None] / 30
    muscles = np.zeros((num_frames, NUM_DIRECTIONS))
    for period_s in (3.1, 1.3, 0.45):
        phase = rng.uniform(0, 2 * np.pi, (1, NUM_DIRECTIONS))
        muscles += rng.uniform(0, 0.7, (1, NUM_DIRECTIONS)) * np.sin(
            2 * np.pi * times_s / period_s + phase
        )
    blinks = rng.random(num_frames) < 0.02
    muscles[:, 0] += 3.0 * np.convolve(blinks, [0.6, 1.0, 0.7, 0.3])[:num_frames]
    talks = np.repeat(rng.random(num_frames // 60 + 1) < 0.8, 60)[:num_frames, None]
    moving = np.cumsum(talks, axis=0)[:, 0] - 1  # at rest the face stays where it is
    muscles = muscles[np.maximum(moving, 0)]
    faces: Float64Array = (liveliness * muscles @ toy_metric().directions).reshape(-1, 8, 8, 4)
    return faces


def toy_pose(seed: int, num_frames: int) -> Float64Array:
    """A head that nods and sways: rotation and translation. ``[T, 2, 3]``."""
    rng = np.random.default_rng([seed, 78])
    times_s = np.arange(num_frames)[:, None, None] / 30
    phase = rng.uniform(0, 2 * np.pi, (1, 2, 3))
    reach = np.array([[0.1], [0.01]])
    pose: Float64Array = reach * np.sin(2 * np.pi * times_s / rng.uniform(1, 4, (1, 2, 3)) + phase)
    return pose


@functools.cache
def toy_profile() -> StreamProfile:
    """Eight components, learned in a fraction of a second."""
    faces = [toy_faces(seed, 150, live) for seed, live in ((1, 1.0), (2, 0.5), (3, 0.2))]
    codes = np.concatenate(faces).reshape(-1, 256)
    return learn_profile(codes, toy_metric(), num_components=NUM_COMPONENTS, turn_sweeps=2)


@functools.cache
def stream_avatar() -> Avatar:
    """The toy avatar with the toy stream."""
    avatar = make_toy_avatar()
    return Avatar(avatar.manifest, {**avatar.tensors, **toy_profile().to_tensors()})


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
        return LatentDecoder(toy_profile()).decode(self.payload)


class Publisher:
    """An encoder with what it sent."""

    def __init__(
        self, profile: StreamProfile | None = None, *, quality: int = DEFAULT_QUALITY
    ) -> None:
        self.encoder = LatentEncoder(profile or toy_profile(), quality=quality)
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
