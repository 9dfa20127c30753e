"""Regions that have not moved: kept, never uploaded again, and never off by more than is said."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import numpy as np
import pytest

from helpers.linear import NUM_STILL, make_linear_avatar
from pica_client.decode.decoder import OnnxDecoder, OnnxOptions
from pica_client.decode.regions import RegionDecoder
from pica_client.decode.request import DecodedMaps, DecodeResult
from pica_client.render.gpu_maps import MapSeries
from pica_core.gl import create_context
from pica_core.reference.decoders import decode_position_map

pytestmark = pytest.mark.render

AVATAR = make_linear_avatar()
SKIP_M = 4e-5
NUM_FRAMES = 60
AHEAD = np.array([0, 0, 1], np.float32)


def latents(count: int, step: float) -> Iterator[np.ndarray]:
    """A face that drifts one way for ever, and trembles."""
    rng = np.random.default_rng(3)
    way, at = rng.standard_normal((2, 8, 8, 4))
    for _ in range(count):
        at = at + step * way + step * rng.standard_normal(at.shape)
        yield at.astype(np.float32)


def worst_m(decoder: RegionDecoder, step: float) -> float:
    return max(
        float(
            np.linalg.norm(
                decoder.decode(each)[0] - decode_position_map(AVATAR, each), axis=2
            ).max()
        )
        for each in latents(NUM_FRAMES, step)
    )


@pytest.mark.parametrize("step", [1e-5, 1e-4, 1e-3, 1e-2])
def test_what_is_skipped_never_adds_up(step: float) -> None:
    decoder = RegionDecoder(AVATAR, SKIP_M)
    assert worst_m(decoder, step) <= SKIP_M + 1e-7
    assert decoder.num_skipped >= NUM_STILL * NUM_FRAMES
    assert (decoder.num_skipped > NUM_STILL * NUM_FRAMES) == (step < 1e-2)


def test_without_a_tolerance_it_is_exact() -> None:
    assert worst_m(RegionDecoder(AVATAR, 0.0), 1e-4) < 1e-7


def test_a_face_at_rest_is_made_once() -> None:
    decoder = RegionDecoder(AVATAR, SKIP_M)
    face = next(latents(1, 1.0))
    (first, versions), (second, versions_then) = decoder.decode(face), decoder.decode(face)
    assert decoder.num_decoded == len(versions) - NUM_STILL
    assert decoder.num_skipped == len(versions) + NUM_STILL
    assert np.array_equal(versions, versions_then)
    assert np.array_equal(first, second)
    assert first is not second


def test_the_avatars_decoder_skips_at_the_full_level() -> None:
    decoder = OnnxDecoder(AVATAR, OnnxOptions(skip_m=SKIP_M))
    face = next(latents(1, 1.0))
    for _ in range(3):
        maps = decoder.decode(face, AHEAD)
    assert decoder.regions is not None
    assert maps.row_versions is not None
    assert decoder.regions.num_decoded == len(maps.row_versions) - NUM_STILL
    assert decoder.regions.num_skipped == 2 * len(maps.row_versions) + NUM_STILL
    assert decoder.decode(face, AHEAD, 64).row_versions is None
    other = OnnxDecoder(AVATAR).decode(face, AHEAD)
    assert other.row_versions is not None
    assert not set(other.row_versions) & set(maps.row_versions)  # rows of two are never confused


def test_an_expression_map_takes_its_vertices_rows_along() -> None:
    decoder = OnnxDecoder(AVATAR)
    face = next(latents(1, 1.0))
    whole = DecodeResult("ada", decoder.decode(face, AHEAD), None)
    turned = DecodeResult("ada", decoder.decode(face, AHEAD, None, "expression"), None)
    maps = turned.completed_by(whole).maps
    assert isinstance(maps, DecodedMaps)
    assert whole.maps is not None
    assert maps.row_versions is whole.maps.row_versions


@pytest.fixture
def context() -> Iterator[moderngl.Context]:
    made = create_context()
    yield made
    made.release()


def test_only_rows_that_changed_are_uploaded(context: moderngl.Context) -> None:
    rows = 40
    series = MapSeries(context, {256: rows}, 3, moderngl.NEAREST)
    rng = np.random.default_rng(5)
    sheet = rng.random((rows, 256, 3), np.float32)
    versions = np.full(rows, 1)
    row_bytes = sheet[0].nbytes

    def upload(changed: list[int], *, known: bool = True) -> int:
        nonlocal sheet, versions
        sheet, versions = sheet.copy(), versions.copy()
        sheet[changed] = rng.random((len(changed), 256, 3), np.float32)
        versions[changed] = versions.max() + 1
        before = series.bytes_written
        series.write(sheet, versions if known else None)
        shown = np.frombuffer(series.newest.read(), np.float32).reshape(sheet.shape)
        assert np.array_equal(shown, sheet)
        return (series.bytes_written - before) // row_bytes

    assert upload([]) == rows  # the first time
    assert upload([]) == 0
    assert upload([0, 1, 20, 39]) == 4
    assert upload([5, 7]) == 3  # nearly neighbours: one run
    assert upload([3], known=False) == rows
    assert upload([]) == rows  # what is there is not known any more
    assert upload([12]) == 1
