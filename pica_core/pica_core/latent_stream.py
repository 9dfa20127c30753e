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

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from pica_core.errors import LatentError, MissingReferenceError, ShapeError
from pica_core.latent_sample import DecodedFrame, EncodedFrame, LatentSample
from pica_core.rate_control import RateController
from pica_core.spec import LATENT_SHAPE, NUM_LATENT
from pica_core.stream_frames import (
    MAX_RESIDUAL,
    FrameState,
    IntArray,
    decode_frame,
    encode_frame,
    frame_type,
    predict,
    quantise,
)
from pica_core.stream_profile import (
    MAX_COEFFICIENT,
    MAX_DISTANCE,
    NUM_POSE,
    POSE_BITS,
    StreamProfile,
)

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
QUIET_ROUNDING = 22
DEFAULT_QUALITY = 3
MAX_PENDING = 8
"""Frames that wait for their reference; beyond it the oldest is given up."""
SEQUENCE_MODULUS = 1 << 16
MAX_AHEAD = 256
"""A sequence further ahead than this, or further behind than any reference, does not go on with the
same count: a second at the fastest rate (chosen)."""
POSE_UNIT = 1.0 / (1 << POSE_BITS)
MAX_POSE = np.repeat((np.pi, 1.0), 3)
"""Rotation vectors (radians) and offsets (metres) are clamped to this: half a turn, an arm's length
about the chair."""


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


def rounding_by_type(num_components: int) -> IntArray:
    """What is added before residuals are cut off, in 64ths of a step. int64 ``[types, C]``."""
    return np.array(
        [
            [latent] * num_components + [pose] * NUM_POSE
            for latent, pose in zip(ROUNDING, POSE_ROUNDING, strict=True)
        ],
        np.int64,
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
        self._rounding = rounding_by_type(profile.num_components)
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
        if not is_quiet:
            self._quiet_since_us = None
        if base is None or self._is_keyframe_due(now_us):
            self._is_silent &= is_quiet
            return self._send(wanted, 0, None, now_us, is_still=self._is_silent)
        if self._is_silent:
            if is_quiet and now_us - self._sent_us < self.config.heartbeat_s * 1e6:
                return None
            self._is_silent = is_quiet
            self._phase = 0
            return self._send(wanted, 0, base, now_us, is_still=is_quiet)
        if is_quiet and self._quiet_since_us is None:
            self._quiet_since_us = now_us
        layer = self._pattern[self._phase]
        if layer == 0:
            is_still = (
                self._quiet_since_us is not None
                and now_us - self._quiet_since_us >= self.config.still_after_s * 1e6
            )
            self._is_silent = is_still
            return self._send(wanted, 0, base, now_us, is_still=is_still)
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
        # Far from the limit of what is decoded: rounding must not step over it.
        np.clip(face, -MAX_COEFFICIENT // 2, MAX_COEFFICIENT // 2, out=face)
        return np.concatenate((face, units.astype(np.int64)))

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
        rounding = QUIET_ROUNDING if kind is None else self._rounding[kind]
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
    ) -> EncodedFrame | None:
        """Encode one frame and go on from it; None if the bitrate has no room for it."""
        sequence = self._sequence + 1
        if reference is not None and sequence - reference.sequence > MAX_DISTANCE:
            layer, reference = 0, None
        kind = frame_type(layer, reference)
        controller, now_s = self._controller, now_us / 1e6
        quality = self._quality if controller is None else controller.propose(layer)
        quality = min(quality + is_still, self.profile.num_qualities - 1)
        while True:
            residual = self._residual(wanted, reference, kind, quality)
            if reference is not None and np.abs(residual).max() > MAX_RESIDUAL:
                # A leap that no face makes, as when a tracker takes one side for the other.
                layer, reference, kind = 0, None, frame_type(0, None)
                residual = self._residual(wanted, None, kind, quality)
            payload, state = encode_frame(
                self.profile,
                np.clip(residual, -MAX_RESIDUAL, MAX_RESIDUAL),
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


@dataclass(slots=True)
class _Strand:
    """Frames of one unbroken count: what a later frame may refer to, and what waits."""

    references: dict[int, FrameState] = field(default_factory=dict)
    """Decoded frames by number, as far back as a reference may be."""
    captured_us: dict[int, int] = field(default_factory=dict)
    """Their capture times."""
    pending: dict[int, tuple[int, int, bytes]] = field(default_factory=dict)
    """Capture time, layer and payload of frames whose reference is not there, by number."""
    newest: int | None = None
    newest_us: int = 0
    newest_base: int | None = None

    def number_of(self, sequence: int) -> int | None:
        """The sequence as a number that never wraps; None if it is too far away."""
        if self.newest is None:
            return sequence
        half = SEQUENCE_MODULUS // 2
        ahead = (sequence - self.newest + half) % SEQUENCE_MODULUS - half
        return self.newest + ahead if -MAX_DISTANCE <= ahead <= MAX_AHEAD else None

    def contradicts(self, number: int, captured_us: int) -> bool:
        """Whether a frame of this number was captured when no frame of this count can have been:
        it is of another life of the stream."""
        if number in self.pending:
            return self.pending[number][0] != captured_us
        if number in self.captured_us:
            return self.captured_us[number] != captured_us
        return self.newest is not None and number < self.newest and captured_us > self.newest_us

    def keep(self, number: int, captured_us: int, state: FrameState) -> int:
        """Keep a decoded frame; how many that waited are given up because they are too old now."""
        self.references[number], self.captured_us[number] = state, captured_us
        if state.layer == 0 and (self.newest_base is None or number > self.newest_base):
            self.newest_base = number
        if self.newest is None or number > self.newest:
            self.newest, self.newest_us = number, captured_us
        for known in [n for n in self.references if n < self.newest - MAX_DISTANCE]:
            del self.references[known], self.captured_us[known]
        old = [n for n in self.pending if n < self.newest - MAX_DISTANCE]
        for waiting in old:
            del self.pending[waiting]
        return len(old)

    def end(self) -> int:
        """Let nothing build on this any more; how many frames that waited are given up."""
        num_waiting = len(self.pending)
        self.references.clear()
        self.captured_us.clear()
        self.pending.clear()
        return num_waiting

    @property
    def is_broken(self) -> bool:
        """Whether a base frame waits that nothing newer has replaced."""
        newest = self.newest_base
        return any(
            layer == 0 and (newest is None or number > newest)
            for number, (_, layer, _) in self.pending.items()
        )


class LatentDecoder:
    """The receiving end of one stream.

    A frame belongs to the *strand* of frames whose count it goes on with. One that fits nowhere (a
    stream that began anew, a leap of the count) opens a strand if it is a keyframe; the one before
    is kept until the new one has gone on, so a single stray keyframe ends nothing. Any other frame
    that fits nowhere is dropped, and if its number is near but its capture time cannot be, then
    the stream began anew and its keyframe was lost: nothing must build on the strand any more.

    Attributes:
        needs_keyframe: Whether frames that could be had are lost without one.
        num_unreferenced: Frames given up because their reference did not come, or was damaged.
    """

    def __init__(self, profile: StreamProfile) -> None:
        self.profile = profile
        self.needs_keyframe = True
        self.num_unreferenced = 0
        self._strand = _Strand()
        self._former: _Strand | None = None

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
        strand, number = self._place(sequence, captured_us, is_keyframe)
        if strand is None:
            self.needs_keyframe = True
            self.num_unreferenced += 1
            return []
        if number in strand.references or number in strand.pending:
            return []
        try:
            frames = [self._decode(strand, number, captured_us, layer, is_keyframe, payload)]
        except MissingReferenceError:
            self._wait(strand, number, captured_us, layer, payload)
            return []
        except LatentError:
            self.needs_keyframe |= layer == 0
            raise
        if strand is self._strand:
            self._former = None
        else:
            self._former = self._strand if strand is not self._former else None
            self._strand = strand
        frames += self._decode_waiting(strand)
        if layer == 0 or len(frames) > 1:
            self.needs_keyframe = strand.is_broken
        return frames

    @property
    def num_kept(self) -> int:
        """Frames in memory: references, and those that wait."""
        strands = (self._strand, self._former or _Strand())
        return sum(len(strand.references) + len(strand.pending) for strand in strands)

    def _place(
        self, sequence: int, captured_us: int, is_keyframe: bool
    ) -> tuple[_Strand | None, int]:
        """The strand that a frame goes on with or opens, and its number there."""
        contradicted = []
        for strand in (self._strand, self._former):
            number = strand.number_of(sequence) if strand is not None else None
            if strand is None or number is None:
                continue
            if not strand.contradicts(number, captured_us):
                return strand, number
            contradicted.append(strand)
        if is_keyframe:
            return _Strand(), sequence
        self.num_unreferenced += sum(strand.end() for strand in contradicted)
        return None, sequence

    def _decode_waiting(self, strand: _Strand) -> list[DecodedFrame]:
        """Decode what waited for the frame that was just decoded, and for each other."""
        frames = []
        progress = True
        while progress and strand.pending:
            progress = False
            for number, (captured_us, layer, payload) in sorted(strand.pending.items()):
                try:
                    frame = self._decode(strand, number, captured_us, layer, False, payload)
                except MissingReferenceError:
                    continue
                except LatentError:  # found out too late to be told: it counts as given up
                    self.num_unreferenced += 1
                else:
                    frames.append(frame)
                strand.pending.pop(number, None)
                progress = True
        return frames

    def _decode(
        self,
        strand: _Strand,
        number: int,
        captured_us: int,
        layer: int,
        is_keyframe: bool,
        payload: bytes,
    ) -> DecodedFrame:
        state, is_still = decode_frame(
            self.profile,
            payload,
            sequence=number,
            layer=layer,
            is_keyframe=is_keyframe,
            references=strand.references,
        )
        self.num_unreferenced += strand.keep(number, captured_us, state)
        count = self.profile.num_components
        pose = (state.coefficients[count:] * POSE_UNIT).astype(np.float32)
        sample = LatentSample(
            latent=self.profile.synthesise(state.coefficients[:count]).reshape(LATENT_SHAPE),
            rotation=pose[:3],
            translation_m=pose[3:],
            is_still=is_still,
        )
        return DecodedFrame(number % SEQUENCE_MODULUS, captured_us, layer, sample)

    def _wait(
        self, strand: _Strand, number: int, captured_us: int, layer: int, payload: bytes
    ) -> None:
        strand.pending[number] = (captured_us, layer, payload)
        if len(strand.pending) > MAX_PENDING:
            del strand.pending[min(strand.pending)]
            self.num_unreferenced += 1
        self.needs_keyframe |= strand.is_broken
