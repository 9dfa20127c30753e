"""Static surfaces in avatar files: every triangle is drawn, and nothing hostile comes in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_core.avatar.file import Avatar, load_avatar, save_avatar, shipped_avatar_files
from pica_core.avatar.levels import (
    MOVING,
    STATIC,
    STATIC_NAME,
    pack_parts,
    parts_of,
)
from pica_core.avatar.spec import AvatarSpec
from pica_core.errors import AvatarFileError
from pica_core.types import Array

pytestmark = pytest.mark.unit

TOY = with_toy_levels(make_toy_avatar(spec=AvatarSpec(uv_encoding_size=16), grid=20))
NUM_VERTICES = len(TOY.tensors["mesh.vertex_uv"])


def marked(packed: Array) -> Avatar:
    return replace(TOY, tensors={**TOY.tensors, STATIC_NAME: packed})


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


def test_parts_come_back_from_a_file_as_they_are(tmp_path: Path) -> None:
    packed = np.arange(-(-NUM_VERTICES // 4), dtype=np.uint8) & 0x55
    save_avatar(tmp_path / "a.pica", marked(packed))

    np.testing.assert_array_equal(load_avatar(tmp_path / "a.pica").tensors[STATIC_NAME], packed)


@pytest.mark.parametrize(
    ("packed", "complaint"),
    [
        (np.zeros(3, np.uint8), rf"static.parts has shape \[3\]; \[{-(-NUM_VERTICES // 4)}\]"),
        (np.zeros(-(-NUM_VERTICES // 4), np.float32), "static.parts is float32; uint8"),
        (np.full(-(-NUM_VERTICES // 4), 0xFF, np.uint8), "static.parts leaves 0 triangles of"),
    ],
)
def test_parts_that_do_not_fit_are_refused(tmp_path: Path, packed: Array, complaint: str) -> None:
    with pytest.raises(AvatarFileError, match=complaint):
        save_avatar(tmp_path / "a.pica", marked(packed))


@pytest.mark.parametrize("file", shipped_avatar_files(), ids=lambda file: file.stem)
def test_shipped_heads_have_static_pullovers_and_moving_faces(file: Path) -> None:
    avatar = load_avatar(file)
    parts, rest_m = parts_of(avatar.tensors), avatar.mean_vertices_m
    assert parts is not None
    used = np.unique(avatar.tensors["mesh.faces"])
    is_face = (rest_m[:, 2] > 0.07) & (np.abs(rest_m[:, 1] + 0.02) < 0.06)

    assert (parts[used][rest_m[used, 1] < -0.2] == STATIC).mean() > 0.7
    assert (parts[is_face] == MOVING).mean() > 0.8
