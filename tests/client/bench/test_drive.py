"""An avatar under live drive, beside the head itself."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.paths import ROOT
from helpers.small_capture import small_head
from pica_client.avatars.library import AvatarLibrary
from pica_client.bench.drive import DriveBenchConfig, run_drive_bench, same_vertices

pytestmark = pytest.mark.render


def test_an_avatar_resembles_its_head_most_at_the_full_level() -> None:
    library = AvatarLibrary()
    amara = library.load(library.find("amara"))
    library.close()
    config = DriveBenchConfig(
        sources=("performance:talk",),
        seconds=3.0,
        moments=2,
        image_size=128,
        person=ROOT / "scripts" / "people" / "amara.json",
    )
    rows = run_drive_bench(config, [amara])["rows"]
    mse = {row["level"]: row["mse"] for row in rows}
    assert len(mse) == len(rows) == 3
    assert mse[256] < mse[64]
    assert all(8_000 < row["wire_bps"] < 25_000 for row in rows)
    assert all(row["lip_mm"] < 1 and row["lid_mm"] < 1 for row in rows)


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
