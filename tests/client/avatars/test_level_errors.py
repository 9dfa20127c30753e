"""`pica avatar measure`: the table of errors that an avatar's levels leave."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.avatars import level_errors
from pica_client.avatars.level_errors import camera_for, measure_levels, with_errors
from pica_client.render.scene import clip_from_head
from pica_client.schedule.visibility import PlacedHead, look
from pica_command.main import main
from pica_core.avatar.file import Avatar, load_avatar, save_avatar

pytestmark = pytest.mark.render

TOY = with_toy_levels(make_toy_avatar(), errors=False)


@pytest.mark.parametrize("head_px", [20.0, 300.0])
@pytest.mark.parametrize(("yaw", "pitch"), level_errors.VIEWS)
def test_a_measured_head_is_as_high_as_it_should_be(
    head_px: float, yaw: float, pitch: float
) -> None:
    camera = camera_for(TOY, head_px, 400, yaw, pitch)
    head = PlacedHead(
        clip_from_head(camera, level_errors.HEAD),
        TOY.manifest.bounds_min_m,
        TOY.manifest.bounds_max_m,
    )
    (sight,) = look([head], (400, 400))
    assert sight.head_px == pytest.approx(head_px, rel=1e-4)
    middle = np.mean([head.low_m, head.high_m], axis=0)
    assert camera.project(middle)[0] == pytest.approx((200, 200), abs=0.1 * head_px)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(level_errors, "HEAD_PX", (24.0, 48.0))
    monkeypatch.setattr(level_errors, "SENSITIVITY_HEAD_PX", 64.0)
    monkeypatch.setattr(level_errors, "TRUTH_PX", 96)
    monkeypatch.setattr(level_errors, "MOMENTS", level_errors.MOMENTS[:1])
    monkeypatch.setattr(level_errors, "VIEWS", level_errors.VIEWS[:2])


@pytest.mark.usefixtures("quick")
def test_a_table_tells_levels_and_meshes_apart_and_is_the_same_each_time() -> None:
    told: list[float] = []
    first, second = measure_levels(TOY, told.append), measure_levels(TOY)
    assert first.levels == TOY.levels
    assert first.mse.shape == (3, 2, 2)
    np.testing.assert_array_equal(first.mse, second.mse)
    # The middle level may beat the full one at heads this small: its maps alias less.
    assert (first.mse[2, 0] < first.mse[0, 0]).all()
    assert (first.mse[:-1, 1] != first.mse[:-1, 0]).all()
    np.testing.assert_array_equal(first.mse[-1, 0], first.mse[-1, 1])
    assert first.view_mse_per_rad2 > 0
    assert first.latent_mse_per_unit2 > 0
    assert told == sorted(told)
    assert told[-1] == 1


def test_a_table_stands_in_the_avatars_file(
    tmp_path: Path, quick: None, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "toy.pica", tmp_path / "measured.pica"
    save_avatar(path, TOY)
    assert main(["avatar", "measure", str(path), "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    before, after = load_avatar(path), load_avatar(out)
    assert before.level_errors is None
    assert after.level_errors is not None
    np.testing.assert_allclose(after.level_errors.mse[0, 1], told["rows"][1]["mse"], rtol=1e-6)
    for name, array in before.tensors.items():
        np.testing.assert_allclose(after.tensors[name], array, atol=1e-6, err_msg=name)


def test_a_table_replaces_the_one_before() -> None:
    measured: Avatar = with_toy_levels(make_toy_avatar())
    errors = measured.level_errors
    assert errors is not None
    doubled = type(errors)(
        levels=errors.levels,
        head_px=errors.head_px,
        mse=errors.mse * 2,
        view_mse_per_rad2=1.0,
        latent_mse_per_unit2=2.0,
    )
    found = with_errors(measured, doubled).level_errors
    assert found is not None
    np.testing.assert_array_equal(found.mse, errors.mse * 2)
    assert (found.view_mse_per_rad2, found.latent_mse_per_unit2) == (1.0, 2.0)
