"""Bits against the error of the rendered face, for every quality of the latent stream.

A row is one profile on one source, at 30 frames a second; its latents are decoded and drawn at some
moments and compared with the drawing of the uncoded latent. What it does not show: networks (`pica
bench voice`), and people: the avatars are synthetic, and only the recording is of a face. An
error of 8 bits and of the pixels that change owner at edges is in every `mse`: about 0.2.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from statistics import median
from typing import Any

import numpy as np

from pica_client.bench.harness import Words, report, timed
from pica_client.bench.head import FaceRenderer
from pica_client.errors import check_ranges
from pica_client.output import say
from pica_client.playout.motion import blend
from pica_client.render.drawing import drawn_mse
from pica_client.sources import open_source
from pica_client.stats import wire_bytes
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.codec.latent_stream import (
    STEPS,
    LatentDecoder,
    LatentEncoder,
    LatentSample,
    StreamConfig,
)
from pica_core.codec.profile import StreamProfile
from pica_core.types import FloatArray
from pica_protocol.frames import HEADER_BYTES

FPS = 30
VIEWS = ("front", "left")
THINNED, THINNED_QUALITY = (2, 4), 3
"""Every how many frames a thinned stream has one, and its quality."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CodecConfig:
    """What to measure."""

    sources: Words = ("performance:talk", "performance:listen", "performance:range_of_motion")
    """What is sent, separated by commas; csv:FILE for a recording, see pica send --help."""
    seconds: float = 60.0
    """Length of each source, counted for the bits."""
    moments: int = 40
    """Moments of each source that are drawn."""
    image_size: int = 256
    """Rows and columns of each drawing, pixels."""

    def __post_init__(self) -> None:
        check_ranges(self, seconds=(1, 600), moments=(1, 2000), image_size=(16, 2048))


@dataclass(slots=True, eq=False)
class Coded:
    """A performance after one profile."""

    shown: list[LatentSample] = field(default_factory=list)
    """The face at each frame time."""
    sizes: list[int] = field(default_factory=list)
    """Payload bytes of each frame that was sent."""
    encode_s: list[float] = field(default_factory=list)
    decode_s: list[float] = field(default_factory=list)


def _pose(sample: LatentSample) -> FloatArray:
    """Rotation and translation, float32 ``[6]``."""
    return np.concatenate((sample.rotation, sample.translation_m))


def run_codec_bench(config: CodecConfig, avatar: Avatar) -> dict[str, Any]:
    """Measure all profiles on all sources.

    Raises:
        ProfileError: The avatar has no stream profile.
        SourceError: A source that cannot be opened.
        GraphicsError: No GL context.
    """
    profile = avatar.stream_profile()
    rows: list[dict[str, Any]] = []
    with FaceRenderer(avatar, size_px=config.image_size, views=VIEWS) as renderer:
        for source in config.sources:
            sent = _read(source, config.seconds, avatar)
            places = np.linspace(FPS / 2, len(sent) - 1, config.moments).astype(int)
            moments = np.unique(places).tolist()
            uncoded = [renderer.draw(sent[moment].latent) for moment in moments]
            for name, code in _coders(profile).items():
                say(f"{source}: {name}")
                coded = code(sent)
                shown = [renderer.draw(coded.shown[moment].latent) for moment in moments]
                errors = [drawn_mse(*pair) for pair in zip(uncoded, shown, strict=True)]
                about = {"profile": name, "source": source, "fps": FPS}
                rows.append(about | _row(sent, coded, errors))
    return report(config, rows, avatar=avatar.manifest.identity, views=VIEWS)


def _read(source: str, seconds: float, avatar: Avatar) -> list[LatentSample]:
    """What a sender makes of a performance, one a frame."""
    player = open_source(source)
    frames = [player.frame_at(index / FPS) for index in range(round(seconds * FPS))]
    arkit = np.stack([frame.arkit for frame in frames])
    return [
        LatentSample(latent=latent, rotation=frame.rotation, translation_m=frame.translation_m)
        for latent, frame in zip(ExpressionEncoder(avatar).encode(arkit), frames, strict=True)
    ]


def _row(sent: Sequence[LatentSample], coded: Coded, errors: Sequence[float]) -> dict[str, Any]:
    """What a profile takes, and what it leaves of a performance."""
    seconds = len(sent) / FPS
    pairs = zip(coded.shown, sent, strict=True)
    pose = np.mean([np.abs(_pose(shown) - _pose(sent)) for shown, sent in pairs], axis=0)
    wire = sum(wire_bytes(1 + HEADER_BYTES + size, is_masked=True) for size in coded.sizes)
    return {
        "payload_bps": round(sum(coded.sizes) * 8 / seconds),
        "wire_bps": round(wire * 8 / seconds),
        "frames_per_s": round(len(coded.sizes) / seconds, 2),
        "mse": round(float(np.mean(errors)), 3),
        "worst_frame_mse": round(max(errors), 3),
        "pose_mrad": round(float(pose[:3].mean()) * 1e3, 3),
        "pose_mm": round(float(pose[3:].mean()) * 1e3, 3),
        "encode_us": round(median(coded.encode_s) * 1e6, 1),
        "decode_us": round(median(coded.decode_s) * 1e6, 1),
    }


def _coders(profile: StreamProfile) -> dict[str, Callable[[Sequence[LatentSample]], Coded]]:
    """What is compared, by name: every quality, and one of them thinned."""
    quality = THINNED_QUALITY
    chosen = {f"quality-{each}": (each, 1) for each in range(len(STEPS))}
    chosen |= {f"quality-{quality}-every-{every}": (quality, every) for every in THINNED}
    return {
        name: partial(code_stream, profile, StreamConfig(fps=FPS, quality=quality), every=every)
        for name, (quality, every) in chosen.items()
    }


def code_stream(
    profile: StreamProfile,
    config: StreamConfig,
    samples: Sequence[LatentSample],
    *,
    every: int = 1,
) -> Coded:
    """Our stream, or every so many of its frames."""
    encoder, decoder = LatentEncoder(profile, config), LatentDecoder(profile)
    found: dict[int, LatentSample] = {}
    coded = Coded()
    sequence = 0
    for index, sample in enumerate(samples):
        now_us = index * 1_000_000 // FPS
        face = sample.latent, sample.rotation, sample.translation_m
        took, frame = timed(encoder.encode, *face, now_us)
        coded.encode_s.append(took.wall_s)
        if frame is None:
            continue
        sequence += -sequence % frame.multiple
        if sequence % every == 0:
            took, found[index] = timed(decoder.decode, frame.payload)
            coded.decode_s.append(took.wall_s)
            coded.sizes.append(len(frame.payload))
        sequence += 1
    coded.shown = [_shown_at(found, index) for index in range(len(samples))]
    return coded


def _shown_at(found: dict[int, LatentSample], index: int) -> LatentSample:
    """The face at a frame time, interpolated where that frame was not sent: as playout does."""
    before = max((place for place in found if place <= index), default=min(found))
    after = min((place for place in found if place > index), default=None)
    if before == index or after is None or found[before].is_still:
        return found[before]
    return blend(found[before], found[after], (index - before) / (after - before))
