"""An avatar under live drive, beside the head itself."""

from functools import partial

import numpy as np
import pytest

from helpers.paths import ROOT
from helpers.toy import grid_faces
from pica_client.avatars.library import AvatarLibrary
from pica_client.bench.drive import DriveBenchConfig, run_drive_bench, same_vertices
from pica_core.capture.person import subject

pytestmark = pytest.mark.render


def test_an_avatar_resembles_its_head_most_at_the_full_level(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    quick = partial(subject.PersonSubject, bake_size=512, self_shadow=False)
    monkeypatch.setattr(subject, "PersonSubject", quick)
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
    mesh = grid_faces(9, 9)
    order = np.random.default_rng(3).permutation(81)
    faces = np.argsort(order)[mesh]
    assert np.array_equal(same_vertices(faces, mesh), order)
    assert np.array_equal(same_vertices(mesh, mesh), np.arange(81))
    faces[7] = faces[7, ::-1]
    assert same_vertices(faces, mesh) is None
    assert same_vertices(mesh[1:], mesh) is None
    assert same_vertices(mesh[:-1], mesh) is None
    more = np.concatenate([mesh, mesh[:1] + 81])
    assert same_vertices(more, mesh).tolist()[-1] == -1
