"""Both ends of a format of payloads, as benches see them, and the plain 8-bit format in that shape.

The coded format has this shape by itself (`pica_core.latent_stream`). A plain frame is a keyframe
of the base layer, always.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy.typing as npt

from pica_core.latent_sample import LatentSample
from pica_core.plain_stream import LatentProfile, decode_latent, encode_latent


class CodedFrame(Protocol):
    """What an encoder gives."""

    @property
    def payload(self) -> bytes:
        """What travels."""

    @property
    def layer(self) -> int:
        """Temporal layer, 0 is the base."""

    @property
    def is_keyframe(self) -> bool:
        """Whether it can be decoded alone."""


class ReadFrame(Protocol):
    """What a decoder gives."""

    @property
    def sequence(self) -> int:
        """As it came."""

    @property
    def captured_us(self) -> int:
        """As it came."""

    @property
    def sample(self) -> LatentSample:
        """The face."""


class Encoder(Protocol):
    """The sender's end."""

    def encode(
        self,
        latent: npt.ArrayLike,
        rotation: npt.ArrayLike,
        translation_m: npt.ArrayLike,
        now_us: int,
    ) -> CodedFrame | None:
        """Encode a face; None if there is nothing to send now."""

    def request_keyframe(self) -> None:
        """Let the next frame be one that can be decoded alone."""


class Decoder(Protocol):
    """The receiver's end."""

    def receive(
        self, sequence: int, captured_us: int, layer: int, is_keyframe: bool, payload: bytes
    ) -> Sequence[ReadFrame]:
        """Take a frame; give those that can be decoded now."""

    @property
    def needs_keyframe(self) -> bool:
        """Whether it cannot go on without one."""


@dataclass(frozen=True, slots=True)
class PlainFrame:
    """A frame that stands alone."""

    payload: bytes
    layer: int = 0
    is_keyframe: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class PlainRead:
    """A frame that was read."""

    sequence: int
    captured_us: int
    sample: LatentSample


class PlainEncoder:
    """The sender's end; keeps no state."""

    def __init__(self, profile: LatentProfile) -> None:
        self._profile = profile

    def encode(
        self,
        latent: npt.ArrayLike,
        rotation: npt.ArrayLike,
        translation_m: npt.ArrayLike,
        now_us: int,
    ) -> PlainFrame:
        """Encode one face."""
        return PlainFrame(encode_latent(latent, rotation, translation_m, self._profile))

    def request_keyframe(self) -> None:
        """Do nothing: every frame is one."""


class PlainDecoder:
    """The receiver's end; keeps no state."""

    needs_keyframe = False

    def __init__(self, profile: LatentProfile) -> None:
        self._profile = profile

    def receive(
        self, sequence: int, captured_us: int, layer: int, is_keyframe: bool, payload: bytes
    ) -> list[PlainRead]:
        """Decode one frame."""
        return [PlainRead(sequence, captured_us, decode_latent(payload, self._profile))]
