"""The page reads avatar files without trust: what Python refuses it refuses, in one line."""

import json
import re
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.page import Page, PageError
from helpers.toy import make_toy_avatar, with_toy_levels
from pica_core.avatar.file import Avatar, load_avatar, save_avatar, shipped_avatar_files
from pica_core.avatar.levels import parts_of
from pica_core.avatar.spec import AvatarSpec
from pica_core.errors import AvatarFileError

pytestmark = pytest.mark.unit

PLAY = "../../../tests/web/play"
SPEC = AvatarSpec(uv_encoding_size=8, axis_encoding_size=20)
DRAWN_BY = ("bounds_max_m", "bounds_min_m", "schema_version", "view_span")
DRAWN_BY += ("block", "encoding", "geometry")
"""What the page reads of a manifest."""
ESSENTIAL = ("linear.mean", "linear.mix", "linear.rank", "mesh.faces", "mesh.vertex_uv")
"""What it wants at once; the rest it misses when it gets ready to draw, see `Scene.dress`."""
WRONG = st.sampled_from(
    [0, -1, 1, 3, 2**31, 2**40, 1e400, 0.5, "", "F64", "I32", None, [], {}, True]
)


@cache
def _toy() -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "toy.pica"
        save_avatar(path, with_toy_levels(make_toy_avatar(spec=SPEC, grid=20)))
        return path.read_bytes()


@pytest.fixture(scope="module")
def page_with_toy(page: Page) -> Page:
    page.call(PLAY, "keep", _toy())
    return page


def _refuses(page: Page, header: str, length: int) -> bool:
    problem = ""
    try:
        page.call(PLAY, "reopen", header, length)
    except PageError as error:
        problem = str(error)
    assert not problem or re.fullmatch("AvatarError: .{1,300}", problem), problem
    return problem != ""


def test_what_is_read_is_what_python_reads(page: Page) -> None:
    path = shipped_avatar_files()[0]
    avatar: Avatar = load_avatar(path)
    found = page.call(PLAY, "open", path.read_bytes())
    for name in ("linear.mix", "u_encoding", "pixel.0.weight", "level.64.expression.bias"):
        np.testing.assert_array_equal(found.floats(name), avatar.tensors[name].ravel())
    for level in avatar.levels:
        assert np.array_equal(found.faces(level), avatar.level_faces(level).ravel())
        assert len(found.facesOf(level, "decoded")) == avatar.decoded_faces(level).size
        assert len(found.facesOf(level, "textured")) == avatar.textured_faces(level).size
    parts = parts_of(avatar.tensors)
    assert parts is not None
    assert [found.part(vertex) for vertex in range(0, 5000, 555)] == parts[:5000:555].tolist()


@settings(max_examples=40, deadline=None)
@given(
    where=st.sampled_from(["entry", "manifest", "spec", "storage", "name", "cut"]),
    picks=st.tuples(st.integers(0, 999), st.integers(0, 999)),
    value=WRONG,
    share=st.floats(0, 0.999),
)
def test_what_python_refuses_the_page_refuses_where_it_draws_by_it(
    page_with_toy: Page, where: str, picks: tuple[int, int], value: Any, share: float
) -> None:
    toy = _toy()
    start = 8 + int.from_bytes(toy[:8], "little")
    header = json.loads(toy[8:start])
    manifest = json.loads(header["__metadata__"]["pica"])

    def picked(names: Any, number: int) -> Any:
        return sorted(names)[picks[number] % len(names)]

    name = picked(header.keys() - {"__metadata__"}, 0)
    is_drawn_by = True
    if where == "entry":
        header[name][picked(header[name], 1)] = value
    elif where == "name":
        header[picked([*header, "__proto__", "more"], 1)] = header.pop(name)
        is_drawn_by = name in ESSENTIAL
    elif where == "storage":
        header["__metadata__"]["storage"] = json.dumps({name: value})
    else:
        told = manifest["spec"] if where == "spec" else manifest
        told[(key := picked(told, 1))] = value
        is_drawn_by = key in DRAWN_BY
        header["__metadata__"]["pica"] = json.dumps(manifest)
    text = json.dumps(header)
    wrong = len(text).to_bytes(8, "little") + text.encode() + toy[start:]
    if where == "cut":
        wrong = wrong[: int(share * len(wrong))]
    try:
        load_avatar(wrong)
    except AvatarFileError:
        assert _refuses(page_with_toy, text, len(wrong)) or not is_drawn_by


def test_triangles_of_vertices_that_are_not_there_are_refused(page: Page) -> None:
    toy = bytearray(_toy())
    start = 8 + int.from_bytes(toy[:8], "little")
    text = toy[8:start].decode()
    faces = start + json.loads(text)["mesh.faces"]["data_offsets"][0]
    page.call(PLAY, "keep", bytes(toy))
    assert not _refuses(page, text, len(toy))
    toy[faces : faces + 2] = 255, 255
    page.call(PLAY, "keep", bytes(toy))
    assert _refuses(page, text, len(toy))
