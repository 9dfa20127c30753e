"""The latent stream: faces in, a few bytes a frame out, and back.

    encoder = LatentEncoder(profile, StreamConfig(fps=30))
    frame = encoder.encode(latent, rotation, translation_m, now_us)      # None: nothing to say
    decoder = LatentDecoder(profile)
    decoder.receive(sequence, captured_us, frame.layer, frame.is_keyframe, frame.payload)

Theory of operation. Frames stand in *temporal layers*: with three, every fourth frame is base (0),
the one between two of those is layer 1, the rest are layer 2. A base frame refers to the base frame
before it, a frame of layer 1 to the last base frame, one of layer 2 to the last frame of a lower
layer. So whoever forwards a stream may leave out layer 2, or 2 and 1, at any moment, and let them
in again at any moment: nothing that is left depends on what is gone. A keyframe refers to nothing;
it comes first, when somebody asks, and every few seconds.

A face that does not change falls silent: one last base frame says so and is a little finer than the
rest (it will be looked at for long), then a heartbeat once a second keeps the stream alive, until
something moves by more than the dead zone.

Every frame says how many frames back its reference is, in the count that the wire's sequence
keeps, so a decoder knows whether it has that very frame. It never guesses: a frame whose reference
is not there waits for it (frames may overtake each other), and when it does not come the decoder
says so and a keyframe heals everything. It cannot show a corrupt face: a payload is decoded whole,
against the right reference, or not at all.

Coding of one frame: `stream_frames`; tables: `stream_profile`; bytes: docs/bitstream.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pica_core.errors import LatentError, MissingReferenceError, ShapeError
from pica_core.latent_sample import DecodedFrame, EncodedFrame, LatentSample
from pica_core.rate_control import RateController
from pica_core.spec import LATENT_SHAPE, NUM_LATENT
from pica_core.stream_frames import (
    FrameState,
    IntArray,
    decode_frame,
    encode_frame,
    frame_type,
    predict,
    quantise,
)
from pica_core.stream_profile import MAX_COEFFICIENT, MAX_DISTANCE, POSE_BITS, StreamProfile

LAYER_PATTERNS: dict[int, tuple[int, ...]] = {1: (0,), 2: (0, 1), 3: (0, 2, 1, 2)}
"""Layers of successive frames, by the number of layers."""
LEAST_BASE_FPS = 5.0
"""A stream has no more layers than leave this many base frames a second: below, a face that lost
its upper layers is a slide show."""
ROUNDING = 22
"""Rounding of residuals in 64ths: a dead zone of 0.66 steps to each side. 32 would be to the
nearest, at 12 % more bits for 9 % less error; below 20 the error grows faster than the bits fall
(measured: docs/results/log.md)."""
DEFAULT_QUALITY = 3
MAX_PENDING = 8
"""Frames that wait for their reference; beyond it the oldest is given up."""
SEQUENCE_MODULUS = 1 << 16
RESTART_DISTANCE = 1000
"""A sequence this far behind is no late frame: the stream began anew."""
POSE_UNIT = 1.0 / (1 << POSE_BITS)
MAX_POSE = np.pi
"""Rotation vectors (radians) and offsets (metres) are clamped to this."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamConfig:
    """How a stream is encoded."""

    fps: float = 30.0
    """Frames a second that `encode` is called with; decides how many layers make sense."""
    quality: int = DEFAULT_QUALITY
    """0 is the coarsest; each step up costs about a third more bits and halves the error. Where a
    rate is kept: the quality to begin with."""
    target_bps: float | None = None
    """Payload bits a second to keep to, by changing the quality; None keeps the quality."""
    num_layers: int | None = None
    """1 to 3 temporal layers; None chooses by `fps`."""
    keyframe_interval_s: float = 10.0
    """A keyframe at least this often, for whoever could not ask for one."""
    keyframe_pause_s: float = 0.25
    """Shortest time between two keyframes; requests in between are answered together."""
    still_after_s: float = 0.25
    """A face that has not changed for so long falls silent."""
    heartbeat_s: float = 1.0
    """Between two frames of a silent face."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("fps", 0.1, 1000),
            ("quality", 0, 15),
            ("target_bps", 100, 1e7),
            ("num_layers", 1, 3),
            ("keyframe_interval_s", 0.1, 3600),
            ("keyframe_pause_s", 0, 60),
            ("still_after_s", 0, 60),
            ("heartbeat_s", 0.1, 60),
        ):
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise ValueError(f"{name} is {value}; {low} to {high} is allowed")

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
        self._controller: RateController | None = None
        if self.config.target_bps is not None:
            self._controller = RateController(
                self.config.target_bps, profile.num_qualities, self.config.quality
            )
        self._sequence = -1
        self._restart()

    def _restart(self) -> None:
        self._phase = 0
        self._base: FrameState | None = None
        self._lower: FrameState | None = None  # newest frame below the top layer
        self._quiet_since_us: int | None = None
        self._is_silent = False
        self._sent_us = 0
        self._keyframe_us: int | None = None
        self._is_keyframe_wanted = True

    def restart(self) -> None:
        """Begin with a keyframe at once: what was encoded before has not arrived anywhere."""
        self._restart()

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
        is_quiet = base is not None and not self._residual(wanted, base, None).any()
        if base is None or self._is_keyframe_due(now_us):
            self._is_silent &= is_quiet
            return self._send(wanted, 0, None, now_us, is_still=self._is_silent)
        if self._is_silent:
            if is_quiet and now_us - self._sent_us < self.config.heartbeat_s * 1e6:
                return None
            self._is_silent = is_quiet
            self._phase = 0
            self._quiet_since_us = self._quiet_since_us if is_quiet else None
            return self._send(wanted, 0, base, now_us, is_still=is_quiet)
        if not is_quiet:
            self._quiet_since_us = None
        elif self._quiet_since_us is None:
            self._quiet_since_us = now_us
        layer = self._pattern[self._phase]
        if layer == 0:
            is_still = (
                self._quiet_since_us is not None
                and now_us - self._quiet_since_us >= self.config.still_after_s * 1e6
            )
            self._is_silent = is_still
            return self._send(wanted, 0, base, now_us, is_still=is_still)
        if self._controller is not None and not self._controller.has_room(now_us / 1e6):
            self._phase = (self._phase + 1) % len(self._pattern)
            return None
        return self._send(wanted, layer, base if layer == 1 else self._lower, now_us)

    def _is_keyframe_due(self, now_us: int) -> bool:
        if self._keyframe_us is None:
            return True
        since_s = (now_us - self._keyframe_us) / 1e6
        if self._is_keyframe_wanted and since_s >= self.config.keyframe_pause_s:
            return True
        return since_s >= self.config.keyframe_interval_s

    def _coefficients(
        self, latent: npt.ArrayLike, rotation: npt.ArrayLike, translation_m: npt.ArrayLike
    ) -> IntArray:
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
        coefficients = np.concatenate((face, units.astype(np.int64)))
        # Where the limits cut, they cut in both ends alike.
        return np.clip(coefficients, -MAX_COEFFICIENT // 2, MAX_COEFFICIENT // 2)

    def _residual(
        self, wanted: IntArray, reference: FrameState | None, kind: int | None, quality: int = -1
    ) -> IntArray:
        """Quantised difference from what a frame type predicts, or from the reference itself."""
        quality = self._quality if quality < 0 else quality
        if kind is not None:
            expected = predict(self.profile, kind, reference)
        else:
            assert reference is not None
            expected = reference.coefficients
        rounding = ROUNDING if reference is not None else 32
        return quantise(wanted - expected, self.profile.steps[quality], rounding)

    @property
    def _quality(self) -> int:
        return self.config.quality if self._controller is None else self._controller.quality

    def _send(
        self,
        wanted: IntArray,
        layer: int,
        reference: FrameState | None,
        now_us: int,
        *,
        is_still: bool = False,
    ) -> EncodedFrame:
        sequence = self._sequence + 1
        if reference is not None and sequence - reference.sequence > MAX_DISTANCE:
            layer, reference = 0, None
        if self._controller is not None and layer == 0:
            self._controller.choose(now_us / 1e6)
        quality = min(self._quality + is_still, self.profile.num_qualities - 1)
        kind = frame_type(layer, reference)
        payload, state = encode_frame(
            self.profile,
            self._residual(wanted, reference, kind, quality),
            sequence=sequence,
            layer=layer,
            quality=quality,
            reference=reference,
            is_still=is_still,
        )
        if self._controller is not None:
            self._controller.sent(len(payload), now_us / 1e6)
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


class LatentDecoder:
    """The receiving end of one stream.

    Attributes:
        needs_keyframe: Whether frames that could be had are lost without one.
        num_unreferenced: Frames given up because their reference did not come.
    """

    def __init__(self, profile: StreamProfile) -> None:
        self.profile = profile
        self.needs_keyframe = True
        self.num_unreferenced = 0
        self._forget()

    def _forget(self) -> None:
        # By sequence: what was decoded, as far back as a reference may be, and what waits.
        self._references: dict[int, FrameState] = {}
        self._pending: dict[int, tuple[int, int, bytes]] = {}
        self._newest: int | None = None

    def receive(
        self, sequence: int, captured_us: int, layer: int, is_keyframe: bool, payload: bytes
    ) -> list[DecodedFrame]:
        """Take a frame off the wire.

        Args:
            sequence: From the frame's header, 0 to 65535.
            captured_us: From the frame's header.
            layer: From the frame's header.
            is_keyframe: From the frame's header.
            payload: Whatever came.

        Returns:
            What can be decoded now, in the order of the sequence: usually this frame; nothing if
            its reference is missing or it is known already; more if others waited for it.

        Raises:
            LatentError: The payload is no frame of this profile; the stream goes on.
        """
        number = self._unwrap(sequence)
        if number in self._references or number in self._pending:
            return []
        if is_keyframe and self._newest is not None and number > self._newest:
            # What came before cannot be referred to any more. (A keyframe that was overtaken by
            # its own successors leaves them alone.)
            self._references.clear()
        try:
            frames = [self._decode(number, captured_us, layer, is_keyframe, payload)]
        except MissingReferenceError:
            self._wait(number, captured_us, layer, payload)
            return []
        progress = True
        while progress and self._pending:
            progress = False
            for waiting, (captured, its_layer, data) in sorted(self._pending.items()):
                try:
                    frames.append(self._decode(waiting, captured, its_layer, False, data))
                except MissingReferenceError:
                    continue
                except LatentError:
                    del self._pending[waiting]
                    raise
                del self._pending[waiting]
                progress = True
        return frames

    def _decode(
        self, number: int, captured_us: int, layer: int, is_keyframe: bool, payload: bytes
    ) -> DecodedFrame:
        state, is_still = decode_frame(
            self.profile,
            payload,
            sequence=number,
            layer=layer,
            is_keyframe=is_keyframe,
            references=self._references,
        )
        if layer == 0:
            self.needs_keyframe = False
        self._references[number] = state
        if self._newest is None or number > self._newest:
            self._newest = number
            for known in [n for n in self._references if n < number - MAX_DISTANCE]:
                del self._references[known]
        count = self.profile.num_components
        pose = (state.coefficients[count:] * POSE_UNIT).astype(np.float32)
        sample = LatentSample(
            latent=self.profile.synthesise(state.coefficients[:count]).reshape(LATENT_SHAPE),
            rotation=pose[:3],
            translation_m=pose[3:],
            is_still=is_still,
        )
        return DecodedFrame(number % SEQUENCE_MODULUS, captured_us, layer, sample)

    def _wait(self, number: int, captured_us: int, layer: int, payload: bytes) -> None:
        if layer == 0:
            self.needs_keyframe = True
        self._pending[number] = (captured_us, layer, payload)
        if len(self._pending) > MAX_PENDING:
            del self._pending[min(self._pending)]
            self.num_unreferenced += 1

    def _unwrap(self, sequence: int) -> int:
        """The sequence as a number that never wraps; a stream that began anew is forgotten."""
        if self._newest is None:
            return sequence
        half = SEQUENCE_MODULUS // 2
        ahead = (sequence - self._newest + half) % SEQUENCE_MODULUS - half
        if ahead < -RESTART_DISTANCE:
            self._forget()
            self.needs_keyframe = True
            return sequence
        return self._newest + ahead
