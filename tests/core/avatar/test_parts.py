"""The sender's encoder, the mesh, `pica avatar info`, and the avatars that ship."""

from pathlib import Path

import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_command.main import main
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import (
    avatar_file,
    avatar_id,
    save_avatar,
    shipped_avatar_files,
    shipped_portraits,
)
from pica_core.cli import AvatarInfoOptions, avatar_info
from pica_core.errors import AvatarFileError, ShapeError
from pica_core.sampling import order_faces

pytestmark = pytest.mark.unit

TOY = make_toy_avatar(grid=24)


def test_an_expression_becomes_a_latent_by_leaky_layers() -> None:
    arkit = np.random.default_rng(0).uniform(0, 1, 52)
    hidden = arkit
    for index in range(2):
        hidden = TOY.tensors[f"encoder.{index}.weight"] @ hidden
        hidden = np.where(hidden > 0, hidden, 0.2 * hidden)
    wanted = (TOY.tensors["encoder.2.weight"] @ hidden).reshape(8, 8, 4)
    np.testing.assert_allclose(ExpressionEncoder(TOY).encode(arkit), wanted, atol=1e-5)


def test_many_expressions_are_encoded_as_one_by_one() -> None:
    encoder = ExpressionEncoder(TOY)
    batch = np.random.default_rng(0).uniform(0, 1, (5, 52)).astype(np.float32)
    together = encoder.encode(batch)
    assert together.shape == (5, 8, 8, 4)
    np.testing.assert_allclose(together[3], encoder.encode(batch[3]), atol=1e-6)


def test_an_expression_of_another_length_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"arkit is \(51,\)"):
        ExpressionEncoder(TOY).encode(np.zeros(51))


def test_ordered_faces_are_the_same_triangles_with_neighbours_close_together() -> None:
    uv, faces = TOY.tensors["mesh.vertex_uv"], TOY.tensors["mesh.faces"]
    shuffled = np.random.default_rng(0).permutation(faces)
    ordered = order_faces(shuffled, uv)
    assert ordered.dtype == np.int32
    assert set(map(tuple, ordered.tolist())) == set(map(tuple, faces.tolist()))
    steps = [np.abs(np.diff(uv[f].mean(axis=1), axis=0)).sum(axis=1) for f in (shuffled, ordered)]
    assert steps[1].mean() < 0.2 * steps[0].mean()


def test_info_names_sizes_and_identity(tmp_path: Path) -> None:
    save_avatar(tmp_path / "toy.pica", TOY)
    found = avatar_info(AvatarInfoOptions(file=tmp_path / "toy.pica"))
    assert found["name"] == "Toy"
    assert found["pixel_decoder"] == 307
    assert found["vertices"] == 24 * 24
    assert found["sha256"] == avatar_id(tmp_path / "toy.pica")


# Those that ship: their names stand for their files in every command that takes one


def test_a_name_is_a_shipped_file_whatever_its_case_and_a_file_is_itself(tmp_path: Path) -> None:
    for path in shipped_avatar_files():
        assert avatar_file(Path(path.stem)) == avatar_file(Path(path.stem.title())) == path
    assert avatar_file(tmp_path / "me.pica") == tmp_path / "me.pica"
    with pytest.raises(AvatarFileError, match="avatar 'nobody' is unknown; shipped are: amara, "):
        avatar_file(Path("nobody"))


def test_a_folder_of_the_same_name_hides_no_avatar_and_an_unknown_home_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "nora").mkdir()

    assert avatar_file(Path("nora")).is_file()
    assert main(["avatar", "info", "~nobody-at-all/x.pica"]) == 2


def test_no_file_that_ships_has_more_than_four_million_bytes() -> None:
    assert all(path.stat().st_size <= 4_000_000 for path in shipped_avatar_files())


def test_a_small_picture_of_each_person_ships() -> None:
    people = {
        file.stem for file in (Path(__file__).parents[3] / "scripts" / "people").glob("*.json")
    }
    portraits = shipped_portraits()
    assert people <= portraits.keys()
    assert all(picture.stat().st_size <= 60_000 for picture in portraits.values())


@pytest.mark.parametrize(
    "words",
    [
        ["avatar", "info"],
        ["send", "--avatar"],
        ["view", "--avatar"],
        ["demo", "--avatar"],
        ["bench", "decode", "--avatar"],
    ],
)
def test_every_command_knows_the_names_of_those_that_ship(
    words: list[str],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*words, "nobody"]) == 2
    names = ", ".join(path.stem for path in shipped_avatar_files())
    known = f"avatar 'nobody' is unknown; shipped are: {names}"
    assert known in capsys.readouterr().err
