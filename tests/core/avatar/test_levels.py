"""Levels of detail: which an avatar has, what they cost in error, what a file may say of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_core.avatar.file import Avatar, load_avatar, save_avatar
from pica_core.avatar.levels import (
    MOVING,
    STATIC,
    STATIC_NAME,
    STILL_NAME,
    faces_name,
    pack_parts,
    parts_of,
)
from pica_core.avatar.spec import AvatarSpec
from pica_core.errors import AvatarFileError
from pica_core.reference import FRONT, decode_expression_map, still_map
from pica_core.types import Array

pytestmark = pytest.mark.unit

SPEC = AvatarSpec(uv_encoding_size=16, axis_encoding_size=20)
PLAIN = make_toy_avatar(grid=8, spec=SPEC)
TOY = with_toy_levels(PLAIN)
LEVEL_NAMES = sorted(name for name in TOY.tensors if name.startswith("level."))


def changed(name: str, array: Array | None) -> Avatar:
    tensors = {key: value for key, value in TOY.tensors.items() if key != name}
    return Avatar(TOY.manifest, tensors if array is None else {**tensors, name: array})


# Which levels there are


def test_an_avatar_has_all_levels_or_the_full_one_alone() -> None:
    assert TOY.levels == (64, 128, 256)
    assert len(TOY.level_faces(64)) < len(TOY.level_faces(128)) < len(TOY.level_faces(256))
    assert PLAIN.levels == (256,)
    with pytest.raises(ValueError, match="level is 64; this avatar has 256"):
        PLAIN.level_faces(64)


# What a file may say of them


def test_the_face_of_the_still_map_comes_back_from_a_file(tmp_path: Path) -> None:
    latent = np.linspace(-1, 1, 256, dtype=np.float32).reshape(8, 8, 4)
    save_avatar(tmp_path / "a.pica", Avatar(TOY.manifest, {**TOY.tensors, STILL_NAME: latent}))
    loaded = load_avatar(tmp_path / "a.pica")
    found = still_map(loaded)
    assert found is not None
    np.testing.assert_allclose(found, decode_expression_map(loaded, latent, FRONT), atol=1e-6)
    assert still_map(PLAIN) is None


PACKED = -(-len(TOY.tensors["mesh.vertex_uv"]) // 4)


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        *((name, None, rf"tensor {name} is missing") for name in LEVEL_NAMES),
        (STATIC_NAME, np.zeros(3, np.uint8), rf"static.parts has shape \[3\]; \[{PACKED}\]"),
        (STATIC_NAME, np.zeros(PACKED, np.float32), "static.parts is float32; uint8"),
        (STATIC_NAME, np.full(PACKED, 0xFF, np.uint8), "static.parts leaves 0 triangles of"),
        ("level.64.surprise", np.zeros(3, np.float32), r"'level\.64\.surprise' is unknown"),
        ("level.128.expression.bias", np.zeros((4, 128), np.float32), r"\[4, 128, 128\]"),
        ("level.64.faces", np.full((9, 3), 64, np.int32), r"level\.64\.faces names vertices 64"),
        ("level.64.faces", np.zeros((0, 3), np.int32), "0 rows; allowed are 1 to"),
        ("level.64.faces", np.zeros((400_001, 3), np.int32), "400001 rows; allowed are 1 to"),
        ("level.64.expression.bias", np.full((4, 64, 64), np.nan, np.float32), "not finite"),
    ],
)
def test_a_level_tensor_that_does_not_fit_is_refused_by_name(
    tmp_path: Path, name: str, array: Array | None, message: str
) -> None:
    with pytest.raises(AvatarFileError, match=message):
        save_avatar(tmp_path / "bad.pica", changed(name, array))
    assert not (tmp_path / "bad.pica").exists()


def test_a_decoded_geometry_has_no_levels(tmp_path: Path) -> None:
    alone = {**PLAIN.tensors, faces_name(64): PLAIN.tensors["mesh.faces"][:4]}
    with pytest.raises(AvatarFileError, match=r"'level\.64\.faces' is unknown"):
        save_avatar(tmp_path / "alone.pica", Avatar(PLAIN.manifest, alone))


LEVELLED = with_toy_levels(make_toy_avatar(spec=AvatarSpec(uv_encoding_size=16), grid=20))
NUM_VERTICES = len(LEVELLED.tensors["mesh.vertex_uv"])


def marked(packed: Array) -> Avatar:
    return replace(LEVELLED, tensors={**LEVELLED.tensors, STATIC_NAME: packed})


@given(arrays.arrays(np.uint8, st.integers(1, 50), elements=st.integers(MOVING, STATIC)))
def test_parts_come_back_from_two_bits_each(parts: Array) -> None:
    tensors = {STATIC_NAME: pack_parts(parts), "mesh.vertex_uv": np.zeros((len(parts), 2))}

    np.testing.assert_array_equal(parts_of(tensors), parts)


@given(arrays.arrays(np.uint8, -(-NUM_VERTICES // 4)))
def test_whatever_the_bits_every_triangle_is_decoded_or_opaque(packed: Array) -> None:
    avatar = marked(packed)
    parts = parts_of(avatar.tensors)
    assert parts is not None

    for level in avatar.levels:
        decoded = set(map(tuple, avatar.decoded_faces(level).tolist()))
        textured = avatar.textured_faces(level)
        opaque = set(map(tuple, textured[(parts[textured] == STATIC).all(axis=1)].tolist()))
        assert not decoded & opaque
        assert decoded | opaque == set(map(tuple, avatar.level_faces(level).tolist()))
