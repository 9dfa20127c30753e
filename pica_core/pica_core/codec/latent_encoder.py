"""The sending end of a latent stream; see `latent_stream` for the theory of both ends."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pica_core.codec import frames
from pica_core.codec.latent_sample import EncodedFrame
from pica_core.codec.profile import (
    MAX_COEFFICIENT,
    MAX_DISTANCE,
    NUM_POSE,
    POSE_UNIT,
    StreamProfile,
)
from pica_core.codec.rate_control import RateController
from pica_core.errors import LatentError, ShapeError, check_ranges
from pica_core.latent import LATENT_SHAPE, NUM_LATENT
from pica_core.types import Int64Array

LAYER_PATTERNS: dict[int, tuple[int, ...]] = {1: (0,), 2: (0, 1), 3: (0, 2, 1, 2)}
"""Layers of successive frames, by the number of layers."""
LEAST_BASE_FPS = 5.0
"""A stream has no more layers than leave this many base frames a second: below, a face that lost
its upper layers is a slide show."""
ROUNDING = (32, 22, 22, 22, 22)
POSE_ROUNDING = (32, 31, 24, 12, 12)
"""Rounding of residuals in 64ths, by frame type: 32 is to the nearest, less leaves a dead zone. On
the latent a dead zone of 0.66 steps to each side saves 12 % of the bits for 9 % more error; below
20 the error grows faster than the bits fall. On the pose it would let the head stick and slip, so
base frames round almost to the nearest (ties would tip to and fro); between them a head moves
evenly, and a frame that only says so again is not worth its bits (measured: docs/results/log.md).
"""
QUIET_ROUNDING = 22
"""The same for telling whether a face is still: what no frame would say must not keep it awake, so
no more than any of a base frame's."""
DEFAULT_QUALITY = 3
KEYFRAME_PAUSE_S = 0.25
"""Shortest time between two keyframes; requests in between are answered together."""
STILL_AFTER_US = 250_000
"""A face that has not changed for so long falls silent."""
HEARTBEAT_US = 1_000_000
"""Time between two frames of a silent face."""
MAX_POSE = np.repeat((np.pi, 1.0), 3)
"""Rotation vectors (radians) and offsets (metres) are clamped to this: half a turn, an arm's length
about the chair."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamConfig:
    """How a stream is encoded."""

    fps: float = 30.0
    """Frames a second that `encode` is called with; decides how many layers make sense."""
    quality: int = DEFAULT_QUALITY
    """0 is the coarsest; each step up costs about a quarter more bits. Where a rate is kept: the
    quality to begin with."""
    target_bps: float | None = None
    """Payload bits a second to keep to, by changing the quality; None keeps the quality."""
    num_layers: int | None = None
    """1 to 3 temporal layers; None chooses by `fps`."""
    keyframe_interval_s: float = 10.0
    """A keyframe at least this often, for whoever could not ask for one."""

    def __post_init__(self) -> None:
        check_ranges(self, fps=(0.1, 1000), num_layers=(1, 3), keyframe_interval_s=(0.1, 3600))
        check_ranges(self, quality=(0, 15), target_bps=(100, 1e7))

    @property
    def layers(self) -> int:
        """The number of temporal layers."""
        if self.num_layers is not None:
            return self.num_layers
        return max(
            count
            for count in LAYER_PATTERNS
            if count == 1 or self.fps / len(LAYER_PATTERNS[count]) >= LEAST_BASE_FPS
        )


def rounding_by_type(num_components: int) -> Int64Array:
    """What is added before residuals are cut off, in 64ths of a step. int64 ``[types, C]``."""
    by_part = np.array([ROUNDING, POSE_ROUNDING], np.int64).T
    return np.repeat(by_part, (num_components, NUM_POSE), axis=1)


class LatentEncoder:
    """The sending end of one stream."""

    def __init__(self, profile: StreamProfile, config: StreamConfig | None = None) -> None:
        """Begin a stream.

        Raises:
            LatentError: A quality that the profile does not have.
        """
        self.profile = profile
        self.config = config or StreamConfig()
        if self.config.quality >= profile.num_qualities:
            raise LatentError(
                f"quality is {self.config.quality}; "
                f"this avatar has 0 to {profile.num_qualities - 1}"
            )
        self._pattern = LAYER_PATTERNS[self.config.layers]
        self._rounding = rounding_by_type(profile.num_components)
        self._controller: RateController | None = None
        if self.config.target_bps is not None:
            self._controller = RateController(
                self.config.target_bps, profile.num_qualities, self.config.quality
            )
        self._sequence = -1
        self.restart()

    def restart(self) -> None:
        """Begin with a keyframe at once: what was encoded before has not arrived anywhere."""
        self._phase = 0
        self._base: frames.FrameState | None = None
        self._lower: frames.FrameState | None = None  # newest frame below the top layer
        self._quiet_since_us: int | None = None
        self._is_silent = False
        self._sent_us = 0
        self._keyframe_us: int | None = None
        self._is_keyframe_wanted = True

    def request_keyframe(self) -> None:
        """Make the next frame a keyframe, unless the last one was a moment ago: then soon."""
        self._is_keyframe_wanted = True

    def encode(
        self,
        latent: npt.ArrayLike,
        rotation: npt.ArrayLike,
        translation_m: npt.ArrayLike,
        now_us: int,
    ) -> EncodedFrame | None:
        """Encode the next frame.

        Every frame that is returned must take the next sequence number of its stream, and none
        else may; see `restart` for when that goes wrong.

        Args:
            latent: Expression code ``[8, 8, 4]``.
            rotation: Head pose, rotation vector, radians ``[3]``.
            translation_m: Offset from the seat, metres ``[3]``.
            now_us: Sender's clock, microseconds; never runs backwards.

        Returns:
            The frame to send, or None: the face is still, or the bitrate has no room.

        Raises:
            ShapeError: An argument of another shape.
            LatentError: A value that is not finite.
        """
        wanted = self._coefficients(latent, rotation, translation_m)
        base = self._base
        is_quiet = base is not None and self._is_quiet(wanted, base)
        if not is_quiet:
            self._quiet_since_us = None
        if base is None or self._is_keyframe_due(now_us):
            self._is_silent &= is_quiet
            return self._send(wanted, 0, None, now_us, is_still=self._is_silent)
        if self._is_silent:
            if is_quiet and now_us - self._sent_us < HEARTBEAT_US:
                return None
            self._is_silent = is_quiet
            self._phase = 0
            return self._send(wanted, 0, base, now_us, is_still=is_quiet)
        if is_quiet and self._quiet_since_us is None:
            self._quiet_since_us = now_us
        layer = self._pattern[self._phase]
        if layer == 0:
            is_still = (
                self._quiet_since_us is not None and now_us - self._quiet_since_us >= STILL_AFTER_US
            )
            self._is_silent = is_still
            return self._send(wanted, 0, base, now_us, is_still=is_still)
        return self._send(wanted, layer, base if layer == 1 else self._lower, now_us)

    def _is_keyframe_due(self, now_us: int) -> bool:
        if self._keyframe_us is None:
            return True
        since_s = (now_us - self._keyframe_us) / 1e6
        if self._is_keyframe_wanted and since_s >= KEYFRAME_PAUSE_S:
            return True
        return since_s >= self.config.keyframe_interval_s

    def _coefficients(
        self, latent: npt.ArrayLike, rotation: npt.ArrayLike, translation_m: npt.ArrayLike
    ) -> Int64Array:
        values = np.asarray(latent, np.float64)
        pose = np.array((rotation, translation_m), np.float64)
        if values.shape != LATENT_SHAPE or pose.shape != (2, 3):
            raise ShapeError(
                f"latent is {values.shape} and the pose {pose.shape}; "
                f"{LATENT_SHAPE} and (2, 3) are needed"
            )
        if not (np.isfinite(values).all() and np.isfinite(pose).all()):
            raise LatentError("latent or pose holds a value that is not finite")
        units = np.rint(np.clip(pose.reshape(-1), -MAX_POSE, MAX_POSE) / POSE_UNIT)
        face = self.profile.analyse(values.reshape(NUM_LATENT))
        # Far from the limit of what is decoded: rounding must not step over it.
        np.clip(face, -MAX_COEFFICIENT // 2, MAX_COEFFICIENT // 2, out=face)
        return np.concatenate((face, units.astype(np.int64)))

    def _is_quiet(self, wanted: Int64Array, base: frames.FrameState) -> bool:
        """Whether a face looks as the last base frame does: a dead zone everywhere, or it would tip
        at every rounding edge."""
        steps = self.profile.steps[self._quality]
        return not frames.quantise(wanted - base.coefficients, steps, QUIET_ROUNDING).any()

    @property
    def _quality(self) -> int:
        return self.config.quality if self._controller is None else self._controller.quality

    def _send(
        self,
        wanted: Int64Array,
        layer: int,
        reference: frames.FrameState | None,
        now_us: int,
        *,
        is_still: bool = False,
    ) -> EncodedFrame | None:
        """Encode one frame and go on from it; None if the bitrate has no room for it."""
        sequence = self._sequence + 1
        if reference is not None and sequence - reference.sequence > MAX_DISTANCE:
            layer, reference = 0, None
        controller, now_s = self._controller, now_us / 1e6
        quality = self._quality if controller is None else controller.propose(layer)
        quality = min(quality + is_still, self.profile.num_qualities - 1)
        while True:
            kind = frames.frame_type(layer, reference)
            residual = frames.quantise(
                wanted - frames.predict(self.profile, kind, reference),
                self.profile.steps[quality],
                self._rounding[kind],
            )
            if reference is not None and np.abs(residual).max() > frames.MAX_RESIDUAL:
                # A leap that no face makes, as when a tracker takes one side for the other.
                layer, reference = 0, None
                continue
            payload, state = frames.encode_frame(
                self.profile,
                np.clip(residual, -frames.MAX_RESIDUAL, frames.MAX_RESIDUAL),
                sequence=sequence,
                layer=layer,
                quality=quality,
                reference=reference,
                is_still=is_still,
            )
            if controller is None or controller.has_room(len(payload), layer, now_s):
                break
            if quality == 0:
                if layer == 0:
                    break
                self._phase = (self._phase + 1) % len(self._pattern)
                return None
            quality -= 1
        if controller is not None:
            controller.sent(len(payload), quality, now_s)
        self._sequence = sequence
        self._sent_us = now_us
        if layer == 0:
            self._base = state
            self._phase = 0
        if layer < 2:
            self._lower = state
        if reference is None:
            self._keyframe_us = now_us
            self._is_keyframe_wanted = False
        self._phase = (self._phase + 1) % len(self._pattern)
        return EncodedFrame(payload, layer, reference is None)
