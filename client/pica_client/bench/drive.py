"""Avatars under live drive, against the head itself at the same values.

The truth is a rig, or a person of the face model, posed by what a source does. The avatar is driven
by the same values, through the latent stream, and shown at each level of detail. `wire_bps` is the
stream's rate with all headers.

Distances are of the vertices of lids and lips. What it does not show: people. The truth is
synthetic, a tracker's own mistakes are not part of it, and delay is no error here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pica_client.bench.harness import FaceRenderer, Words, evaluation_cameras, report
from pica_client.errors import OptionError, check_ranges
from pica_client.render.drawing import masked_mse
from pica_client.sources import Source, open_source
from pica_client.stats import wire_bytes
from pica_client.system import say
from pica_core.avatar.file import Avatar
from pica_core.capture.stage.subject import Subject
from pica_core.codec.latent_stream import (
    BEST_QUALITY,
    DEFAULT_QUALITY,
    LatentDecoder,
    LatentEncoder,
)
from pica_core.types import FloatArray, Image, IntArray
from pica_protocol.frames import HEADER_BYTES

FPS = 30
VIEWS = ("front", "left")
REGIONS = ("lids", "lips")


@dataclass(frozen=True, kw_only=True, slots=True)
class DriveBenchConfig:
    """What to measure."""

    sources: Words = ("performance:talk", "performance:listen", "performance:range_of_motion")
    """What the person does, separated by commas; csv:FILE for recordings."""
    quality: int = DEFAULT_QUALITY
    """Of the latent stream: 0 is the coarsest."""
    rig: Path | None = None
    """The rig that the avatar was made of."""
    person: Path | None = None
    """Instead of a rig, the JSON file of a person that the avatar was made of."""
    seconds: float = 20.0
    """Length of each source."""
    moments: int = 24
    """Moments of each source that are drawn."""
    image_size: int = 320
    """Rows and columns of each picture, pixels."""

    def __post_init__(self) -> None:
        check_ranges(self, seconds=(1, 600), moments=(1, 2000))
        check_ranges(self, image_size=(64, 1024), quality=(0, BEST_QUALITY))


class _Truth(NamedTuple):
    """The head itself at one moment: images ``[views, H, W, 3]`` and vertices ``[V, 3]``."""

    images: Image
    vertices_m: FloatArray


class _Shown(NamedTuple):
    """Errors of one moment as an avatar shows it, by view and by region."""

    mse: list[float]
    region_mm: dict[str, float]


def run_drive_bench(config: DriveBenchConfig, avatars: Sequence[Avatar]) -> dict[str, Any]:
    """Measure avatars, one after the other.

    Raises:
        OptionError: An avatar whose head is not named, or not its own.
        SourceError: A source that cannot be opened.
        GraphicsError: No GL context.
    """
    rows: list[dict[str, Any]] = []
    for avatar in avatars:
        rows += _measure(config, avatar)
    return report(config, rows, views=VIEWS)


def _measure(config: DriveBenchConfig, avatar: Avatar) -> list[dict[str, Any]]:
    """The rows of one avatar."""
    subject = _subject(config, avatar)
    num_frames = round(config.seconds * FPS)
    moments = np.unique(np.linspace(FPS / 2, num_frames - 1, config.moments).astype(int)).tolist()
    name = avatar.manifest.name
    truth = {}
    try:
        for source in config.sources:
            say(f"{name}: {source}: the head itself")
            arkit = values_of(open_source(source), num_frames)
            truth[source] = [_draw_truth(subject, arkit[each], config) for each in moments]
    finally:
        subject.release()  # one GL context at a time on this thread
    rows = []
    with FaceRenderer(avatar, size_px=config.image_size, views=VIEWS) as renderer:
        compare = _Comparison(avatar, subject, renderer)
        for source in config.sources:
            say(f"{name}: {source}: the avatar")
            values = values_of(open_source(source), num_frames)
            latents, wire_bps = through_stream(avatar, values, config.quality)
            for level in avatar.levels:
                shown = [
                    compare(latents[moment], level, true)
                    for moment, true in zip(moments, truth[source], strict=True)
                ]
                about = {"avatar": name, "source": source, "level": level}
                rows.append(about | {"wire_bps": wire_bps} | _row(shown))
    return rows


def _subject(config: DriveBenchConfig, avatar: Avatar) -> Subject:
    """Return the subject that draws the truth; OptionError without one, or with another mesh."""
    identity = avatar.manifest.identity
    subject: Subject
    if config.rig is not None:
        # Only here: rigs need an extra that a viewer lacks.
        from pica_core.capture.stage.subject import RigSubject

        subject = RigSubject(config.rig)
    elif config.person is not None:
        from pica_core.capture.person.choices import read_person
        from pica_core.capture.person.subject import PersonSubject

        subject = PersonSubject(read_person(config.person))
    else:
        raise OptionError(f"avatar {identity!r}: name the --rig or the --person it was made of")
    if _order(avatar, subject) is None:
        raise OptionError(f"avatar {identity!r} has another mesh than {subject.name!r}")
    return subject


def _order(avatar: Avatar, subject: Subject) -> IntArray | None:
    """The vertex of a subject at each vertex of an avatar, `same_vertices`."""
    chart, mesh = subject.topology.faces, subject.head.mesh.faces
    return same_vertices(avatar.tensors["mesh.faces"], chart[: len(mesh)])


def same_vertices(faces: IntArray, wanted: IntArray) -> IntArray | None:
    """The vertex of the truth at each vertex of an avatar, whose bases may have reordered them.

    An avatar keeps the triangles of its capture in their order. Texture coordinates say nothing,
    and neither do the triangles that a chart adds along its seams after those of the mesh: another
    version of us may have packed it otherwise.

    Args:
        faces: The avatar's triangles, int32 ``[F, 3]``, which use all of its vertices.
        wanted: The mesh's, in the vertices of the truth, int32 ``[M, 3]``.

    Returns:
        int32 ``[V]``, -1 for what seams have added; None if they are not the same.
    """
    count = len(wanted)
    found = np.full(faces.max() + 1, -1, np.int32)
    found[faces[:count]] = wanted[: len(faces)]
    return found if np.array_equal(found[faces[:count]], wanted) else None


def _draw_truth(subject: Subject, arkit: FloatArray, config: DriveBenchConfig) -> _Truth:
    vertices_m = subject.pose(arkit)
    views = [subject.draw(camera) for camera in evaluation_cameras(VIEWS, config.image_size)]
    return _Truth(np.stack([view.image for view in views]), vertices_m)


class _Comparison:
    """Shows latents of one avatar beside the truth."""

    def __init__(self, avatar: Avatar, subject: Subject, renderer: FaceRenderer) -> None:
        self._avatar, self._renderer = avatar, renderer
        order = _order(avatar, subject)
        assert order is not None  # `_subject` has looked
        self._order = order
        self._used = {
            level: np.unique(avatar.level_faces(level)) for level in avatar.levels[:-1]
        } | {avatar.levels[-1]: np.arange(len(order))}
        known = order >= 0
        regions = {name: mask[order] & known for name, mask in subject.topology.regions.items()}
        self._regions = {name: regions[name] for name in REGIONS}

    def __call__(self, latent: FloatArray, level: int, truth: _Truth) -> _Shown:
        """One moment at a level."""
        drawn = self._renderer.draw(latent, level=level)
        errors = [
            masked_mse(image, drawing.image, drawing.covered)
            for (drawing, _), image in zip(drawn, truth.images, strict=True)
        ]
        position_map = drawn[0][1].position_map
        assert position_map is not None  # both maps were asked for
        return _Shown(errors, self._region_errors(position_map, level, truth.vertices_m))

    def _region_errors(
        self, position_map: FloatArray, level: int, truth_m: FloatArray
    ) -> dict[str, float]:
        used = self._used[level]
        vertices_m = self._avatar.vertices_of(position_map, level)
        off_m = vertices_m.astype(np.float64) - truth_m[self._order[used]]
        distance_mm = 1000 * np.linalg.norm(off_m, axis=1)
        regions = {name: mask[used] for name, mask in self._regions.items()}
        return {
            name: float(distance_mm[mask].mean()) for name, mask in regions.items() if mask.any()
        }


def _row(shown: Sequence[_Shown]) -> dict[str, Any]:
    mse = np.concatenate([each.mse for each in shown])
    mm = {name: np.mean([each.region_mm[name] for each in shown]) for name in REGIONS}
    return {
        "mse": round(float(mse.mean()), 3),
        "lid_mm": round(float(mm["lids"]), 4),
        "lip_mm": round(float(mm["lips"]), 4),
    }


def values_of(source: Source, num_frames: int) -> FloatArray:
    """What a source does at the moments of `FPS`. float32 ``[T, 52]``."""
    return np.stack([source.frame_at(number / FPS).arkit for number in range(num_frames)])


def through_stream(avatar: Avatar, values: FloatArray, quality: int) -> tuple[FloatArray, int]:
    """The latents that a receiver decodes of ARKit values ``[T, 52]``, and bits a second of their
    way to it."""
    encoder = LatentEncoder(fps=FPS, quality=quality)
    decoder, still = LatentDecoder(avatar), np.zeros(3, np.float32)
    shown, num_bytes = [], 0
    for number, arkit in enumerate(values):
        coded = encoder.encode(arkit, still, still, number * 1_000_000 // FPS)
        if coded is not None:
            num_bytes += wire_bytes(1 + HEADER_BYTES + len(coded.payload), is_masked=False)
            newest = decoder.decode(coded.payload).latent
        shown.append(newest)  # a face that stands still is not sent
    return np.stack(shown), round(num_bytes * 8 * FPS / len(values))
