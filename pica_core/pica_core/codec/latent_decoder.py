"""The receiving end of a latent stream; see `latent_stream` for the theory of both ends."""

import math

import numpy as np

from pica_core.codec.frames import FrameState, decode_frame
from pica_core.codec.latent_sample import DecodedFrame, LatentSample, ReceivedFrame
from pica_core.codec.profile import MAX_DISTANCE, POSE_UNIT, StreamProfile
from pica_core.errors import LatentError, MissingReferenceError
from pica_core.latent import LATENT_SHAPE

MAX_PENDING = 8
"""Frames that wait for their reference; beyond it the oldest is given up."""


class LatentDecoder:
    """The receiving end of one stream.

    Frames come with numbers that never wrap, and leap where the sender began anew: what went before
    is then out of any reference's reach, so two lives of a stream are never mixed.

    Attributes:
        needs_keyframe: Whether frames that could be had are lost without one.
        num_unreferenced: Frames given up because their reference did not come, or was damaged.
    """

    def __init__(self, profile: StreamProfile) -> None:
        self.profile = profile
        self.needs_keyframe = True
        self.num_unreferenced = 0
        # By number; decoded frames as far back as a reference may be, and frames without theirs.
        self._references: dict[int, FrameState] = {}
        self._pending: dict[int, ReceivedFrame] = {}
        self._newest = self._newest_base = -math.inf  # numbers

    def receive(self, frame: ReceivedFrame) -> list[DecodedFrame]:
        """Take a frame off the wire.

        Returns:
            What can be decoded now, in the order of the numbers: usually this frame; nothing if
            its reference is missing or it is known already; more if others waited for it.

        Raises:
            LatentError: The payload is no frame of this profile; the stream goes on.
        """
        number = frame.number
        if number in self._references or number in self._pending:
            return []
        if number < self._newest - MAX_DISTANCE and not frame.is_keyframe:
            self.needs_keyframe = True  # what it refers to is forgotten
            self.num_unreferenced += 1
            return []
        try:
            frames = [self._decode(frame, frame.arrived_s)]
        except MissingReferenceError:
            self._pending[number] = frame
            if len(self._pending) > MAX_PENDING:
                del self._pending[min(self._pending)]
                self.num_unreferenced += 1
            self.needs_keyframe |= self._is_broken
            return []
        except LatentError:
            self.needs_keyframe |= frame.layer == 0
            raise
        frames += self._decode_waiting(frame.arrived_s)
        if frame.layer == 0 or len(frames) > 1:
            self.needs_keyframe = self._is_broken
        return frames

    @property
    def num_kept(self) -> int:
        """Frames in memory: references, and those that wait."""
        return len(self._references) + len(self._pending)

    @property
    def _is_broken(self) -> bool:
        """Whether a base frame waits that nothing newer has replaced."""
        return any(
            frame.layer == 0 and number > self._newest_base
            for number, frame in self._pending.items()
        )

    def _decode_waiting(self, now: float) -> list[DecodedFrame]:
        """Decode what waited for the frame that was just decoded, and for each other."""
        frames = []
        progress = True
        while progress and self._pending:
            progress = False
            for number, frame in sorted(self._pending.items()):
                try:
                    frames.append(self._decode(frame, now))
                except MissingReferenceError:
                    continue
                except LatentError:  # found out too late to be told: it counts as given up
                    self.num_unreferenced += 1
                self._pending.pop(number, None)
                progress = True
        return frames

    def _decode(self, frame: ReceivedFrame, now: float) -> DecodedFrame:
        state, is_still = decode_frame(
            self.profile,
            frame.payload,
            sequence=frame.number,
            layer=frame.layer,
            is_keyframe=frame.is_keyframe,
            references=self._references,
        )
        self._keep(frame.number, state)
        count = self.profile.num_components
        pose = (state.coefficients[count:] * POSE_UNIT).astype(np.float32)
        sample = LatentSample(
            latent=self.profile.synthesise(state.coefficients[:count]).reshape(LATENT_SHAPE),
            rotation=pose[:3],
            translation_m=pose[3:],
            is_still=is_still,
        )
        return frame.decoded(sample, now)

    def _keep(self, number: int, state: FrameState) -> None:
        """Keep a decoded frame, and give up what is too old now; all, before an old keyframe."""
        if number < self._newest - MAX_DISTANCE:
            self.num_unreferenced += len(self._pending)
            self._references.clear()
            self._pending.clear()
            self._newest = self._newest_base = -math.inf
        self._references[number] = state
        if state.layer == 0:
            self._newest_base = max(self._newest_base, number)
        self._newest = max(self._newest, number)
        oldest = self._newest - MAX_DISTANCE
        for known in [known for known in self._references if known < oldest]:
            del self._references[known]
        for waiting in [waiting for waiting in self._pending if waiting < oldest]:
            del self._pending[waiting]
            self.num_unreferenced += 1
