"""Avatars under live drive, against the head itself at the same values.

The truth is a rig, or a person of the face model, posed by what a source does. The
avatar is driven by the same values through each step of a live call (`drive_steps`) and shown at
each level of detail.

Distances are of the vertices of lids and lips; `poke_ratio` is the share of the head's pixels that
show another part than the truth within a pixel. What it does not show: people. The truth is
synthetic, a tracker's own mistakes are not part of it, and delay is no error here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pica_client.bench.codec import FPS
from pica_client.bench.drive_steps import (
    STAGES,
    shown_latents,
    stage_values,
    values_of,
)
from pica_client.bench.harness import Words, check_names, report
from pica_client.bench.head import FaceRenderer, evaluation_cameras
from pica_client.errors import OptionError, check_ranges
from pica_client.output import say
from pica_client.render.drawing import masked_mse
from pica_client.sources import open_source
from pica_core.avatar.file import Avatar
from pica_core.capture.dataset.files import Topology
from pica_core.capture.face_errors import poking, region_errors_mm, vertex_parts
from pica_core.capture.stage.subject import Subject
from pica_core.capture.triangles import signed_areas, spread_samples
from pica_core.types import ByteArray, FloatArray, Image, IntArray

VIEWS = ("front", "left")
REGIONS = ("lids", "lips")
PART_MAP_SIZE = 1024
SAMPLES_PER_TEXEL = 3
GROWN_TEXELS = 16
"""How far charts of the map of parts bleed: a coarse mesh reaches a little beyond them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DriveBenchConfig:
    """What to measure."""

    sources: Words = ("performance:talk", "performance:listen", "performance:range_of_motion")
    """What the person does, separated by commas; csv:FILE or take:FILE for recordings."""
    stages: Words = STAGES
    """Which of driver, codec, live, offset and calibrated."""
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
        check_ranges(self, image_size=(64, 1024))
        check_names("stage", self.stages, STAGES)


class _Truth(NamedTuple):
    """The head itself at one moment.

    Attributes:
        images: From each view, uint8 ``[views, H, W, 3]``.
        parts: As masks of captures, uint8 ``[views, H, W]``.
        vertices_m: float32 ``[V, 3]``.
    """

    images: Image
    parts: ByteArray
    vertices_m: FloatArray


class _Shown(NamedTuple):
    """Errors of one moment as an avatar shows it, by view and by region."""

    mse: list[float]
    poke_ratio: list[float]
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
            for stage in config.stages:
                say(f"{name}: {source}: {stage}")
                values = stage_values(stage, open_source(source), num_frames)
                latents = shown_latents(avatar, values, coded=stage != "driver")
                for level in avatar.levels:
                    shown = [
                        compare(latents[moment], level, true)
                        for moment, true in zip(moments, truth[source], strict=True)
                    ]
                    about = {"avatar": name, "source": source, "stage": stage, "level": level}
                    rows.append(about | _row(shown))
    return rows


def _subject(config: DriveBenchConfig, avatar: Avatar) -> Subject:
    """Who can draw the truth.

    Raises:
        OptionError: None is named, or it has another mesh than the avatar.
    """
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
    images, masks = zip(*((view.image, view.mask) for view in views), strict=True)
    return _Truth(np.stack(images), np.stack(masks), vertices_m)


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
        uv, faces = (avatar.tensors[f"mesh.{name}"] for name in ("vertex_uv", "faces"))
        self._parts = part_map(Topology(vertex_uv=uv, faces=faces, regions=regions))

    def __call__(self, latent: FloatArray, level: int, truth: _Truth) -> _Shown:
        """One moment at a level."""
        surfaces = list(self._renderer.surfaces(latent, level))
        errors, pokes = [], []
        for surface, image, parts in zip(surfaces, truth.images, truth.parts, strict=True):
            shown = np.where(surface.covered, read_parts(self._parts, surface.uv), 0)
            where = poking(shown.astype(np.uint8), parts)
            pokes.append(float(where.sum() / max(np.count_nonzero(parts), 1)))
            errors.append(masked_mse(image, surface.image, surface.covered))
        region_mm = self._region_errors(surfaces[0].position_map, level, truth.vertices_m)
        return _Shown(errors, pokes, region_mm)

    def _region_errors(
        self, position_map: FloatArray, level: int, truth_m: FloatArray
    ) -> dict[str, float]:
        used = self._used[level]
        vertices_m = self._avatar.vertices_of(position_map, level)
        regions = {name: mask[used] for name, mask in self._regions.items()}
        return region_errors_mm(vertices_m, truth_m[self._order[used]], regions)


def part_map(topology: Topology, size: int = PART_MAP_SIZE) -> ByteArray:
    """The part of each place of a UV layout, as `vertex_parts` numbers them. uint8 ``[S, S]``."""
    uv, faces = topology.vertex_uv * size, topology.faces
    parts = vertex_parts(topology.regions, len(uv))[faces[:, 2]]
    count = np.ceil(SAMPLES_PER_TEXEL * np.abs(signed_areas(uv, faces))).astype(np.int64) + 1
    which, u, v = spread_samples(count)
    corners = uv[faces[which]]
    at = (1 - u - v)[:, None] * corners[:, 0] + u[:, None] * corners[:, 1]
    at += v[:, None] * corners[:, 2]
    columns, rows = np.clip(at.astype(np.int64), 0, size - 1).T
    found = np.zeros((size, size), np.uint8)
    found[rows, columns] = parts[which]
    for _ in range(GROWN_TEXELS):
        around = np.pad(found, 1)
        for beside in (around[:-2, 1:-1], around[2:, 1:-1], around[1:-1, :-2], around[1:-1, 2:]):
            found = np.where(found == 0, beside, found)
    return found


def read_parts(parts: ByteArray, uv: FloatArray) -> ByteArray:
    """The parts at texture coordinates ``[..., 2]``, by the nearest texel."""
    size = len(parts)
    place = np.clip((uv * size).astype(np.int64), 0, size - 1)
    return parts[place[..., 1], place[..., 0]]


def _row(shown: Sequence[_Shown]) -> dict[str, Any]:
    mse = np.concatenate([each.mse for each in shown])
    pokes = np.concatenate([each.poke_ratio for each in shown])
    mm = {name: np.mean([each.region_mm[name] for each in shown]) for name in REGIONS}
    return {
        "mse": round(float(mse.mean()), 3),
        "p95_mse": round(float(np.percentile(mse, 95)), 3),
        "lid_mm": round(float(mm["lids"]), 4),
        "lip_mm": round(float(mm["lips"]), 4),
        "poke_ratio": round(float(pokes.mean()), 6),
        "p95_poke_ratio": round(float(np.percentile(pokes, 95)), 6),
        "most_poke_ratio": round(float(pokes.max()), 6),
    }
