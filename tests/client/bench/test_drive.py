"""An avatar under live drive, beside the head itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from helpers.paths import ROOT
from helpers.small_capture import small_head
from pica_client.avatars.library import AvatarLibrary
from pica_client.bench.drive import (
    LIDS,
    OFFSET,
    DriveBenchConfig,
    as_offset_person,
    calibration_of,
    live_values,
    part_map,
    perfect_tracker,
    read_parts,
    run_drive_bench,
    same_vertices,
    values_of,
)
from pica_client.sources import open_source
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.capture.face_errors import vertex_parts

pytestmark = pytest.mark.render


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    library = AvatarLibrary()
    amara = library.load(library.find("amara"))
    library.close()
    config = DriveBenchConfig(
        sources=("performance:talk",),
        stages=("driver", "offset", "calibrated"),
        seconds=3.0,
        moments=2,
        image_size=128,
        person=ROOT / "scripts" / "people" / "amara.json",
    )
    found: list[dict[str, Any]] = run_drive_bench(config, [amara])["rows"]
    return found


def test_calibration_takes_most_of_an_offset_person_s_error_away(
    rows: list[dict[str, Any]],
) -> None:
    assert len(rows) == 3 * 3
    by_stage = {row["stage"]: row for row in rows if row["level"] == 256}
    driver, offset, calibrated = (by_stage[name] for name in ("driver", "offset", "calibrated"))
    assert calibrated["mse"] - driver["mse"] < 0.5 * (offset["mse"] - driver["mse"])
    assert calibrated["lip_mm"] < 0.6 * offset["lip_mm"]


def test_an_offset_person_is_at_rest_after_calibration_and_still_blinks() -> None:
    rest, closed = np.zeros((2, NUM_ARKIT), np.float32)
    closed[ARKIT_INDEX["eyeBlinkLeft"]] = closed[ARKIT_INDEX["eyeBlinkRight"]] = 1
    said = as_offset_person(rest)
    assert said[ARKIT_INDEX["mouthSmileLeft"]] == pytest.approx(OFFSET)
    assert said[ARKIT_INDEX["eyeBlinkRight"]] == pytest.approx(LIDS[0])
    calibration = calibration_of(as_offset_person)
    assert calibration.apply(said) == pytest.approx(rest, abs=1e-6)
    assert calibration.apply(as_offset_person(closed)) == pytest.approx(closed, abs=1e-6)


def test_a_perfect_tracker_s_live_face_is_the_source_but_for_smoothing() -> None:
    wanted = values_of(open_source("performance:talk"), 90)
    found = live_values(perfect_tracker(open_source("performance:talk"), np.copy), 90, None)
    assert found.shape == wanted.shape
    # The first sample comes in from rest over 0.4 s.
    assert 0 < np.abs(found - wanted)[15:].mean() < 0.02
    jaw = ARKIT_INDEX["jawOpen"]
    assert np.corrcoef(found[15:, jaw], wanted[15:, jaw])[0, 1] > 0.9


def test_the_map_of_parts_says_of_every_vertex_what_it_is() -> None:
    topology = small_head().topology
    found = read_parts(part_map(topology), topology.vertex_uv)
    assert (found == vertex_parts(topology.regions, len(topology.vertex_uv))).mean() > 0.97


def test_vertices_of_an_avatar_are_found_in_any_order_and_no_others() -> None:
    head = small_head().topology
    order = np.random.default_rng(3).permutation(len(head.vertex_uv))
    faces = np.argsort(order)[head.faces]
    assert np.array_equal(same_vertices(faces, head.faces), order)
    assert np.array_equal(same_vertices(head.faces, head.faces), np.arange(len(head.vertex_uv)))
    faces[7] = faces[7, ::-1]
    assert same_vertices(faces, head.faces) is None
    assert same_vertices(head.faces[1:], head.faces) is None
    assert same_vertices(head.faces[:-1], head.faces) is None
    more = np.concatenate([head.faces, head.faces[:1] + len(order)])
    assert same_vertices(more, head.faces).tolist()[-1] == -1
