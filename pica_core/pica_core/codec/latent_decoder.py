"""The receiving end of a latent stream; see `latent_stream` for the theory of both ends."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pica_core.avatar.spec import LATENT_SHAPE
from pica_core.codec.frames import FrameState, decode_frame
from pica_core.codec.latent_sample import DecodedFrame, LatentSample
from pica_core.codec.profile import MAX_DISTANCE, POSE_UNIT, StreamProfile
from pica_core.errors import LatentError, MissingReferenceError

MAX_PENDING = 8
"""Frames that wait for their reference; beyond it the oldest is given up."""
SEQUENCE_MODULUS = 1 << 16
MAX_AHEAD = 256
"""A sequence further ahead than this, or further behind than any reference, does not go on with the
same count: a second at the fastest rate (chosen)."""


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
