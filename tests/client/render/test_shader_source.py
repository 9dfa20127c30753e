"""Shaders as text: includes, sizes, weights, and messages that point at our files."""

from __future__ import annotations

import re

import numpy as np
import pytest

from helpers.shader_weights import unpack_weights
from helpers.toy import make_toy_avatar
from pica_client.errors import ShaderError
from pica_client.render import shader_source
from pica_client.render.shader_source import LINES_PER_FILE, MAX_DEPTH, compose
from pica_client.render.shader_weights import (
    block_sizes,
    layer_blocks,
    pack_weights,
    siren_source,
)
from pica_core.avatar.spec import AvatarSpec

pytestmark = pytest.mark.unit

TOY = make_toy_avatar(grid=4)
NARROW = AvatarSpec(encoding="uv")


def decoder_text(dialect: shader_source.Dialect = "330 core") -> str:
    return compose(
        "pixel_decoder.frag",
        TOY.spec,
        dialect=dialect,
        generated={"SIREN": siren_source(TOY.spec)},
    ).text


def fake_files(monkeypatch: pytest.MonkeyPatch, **texts: str) -> None:
    files = {f"{name}.glsl": text for name, text in texts.items()}
    monkeypatch.setattr(shader_source, "_read", files.get)


def test_the_version_comes_first_and_no_include_is_left() -> None:
    text = decoder_text()
    assert text.startswith("#version 330 core\n")
    assert "#include" not in text


def test_the_same_files_come_out_in_the_browsers_dialect() -> None:
    text = decoder_text("300 es")
    assert text.startswith("#version 300 es\nprecision highp float;\n")
    desktop, browser = decoder_text().split("\n")[1:], text.split("\n")[1:]
    assert [line for line in browser if not line.startswith("precision")] == desktop


def test_sizes_come_from_the_spec() -> None:
    assert f"#define AXIS_SIZE {TOY.spec.axis_encoding_size}\n" in decoder_text()


def test_a_file_is_included_once(monkeypatch: pytest.MonkeyPatch) -> None:
    fake_files(monkeypatch, a='#include "b.glsl"\n#include "b.glsl"\nvoid a();', b="void b();")
    assert compose("a.glsl").text.count("void b();") == 1


def test_lines_are_numbered_by_file(monkeypatch: pytest.MonkeyPatch) -> None:
    fake_files(monkeypatch, a='first\n#include "b.glsl"\nthird', b="inner")
    lines = compose("a.glsl").text.splitlines()
    assert lines[lines.index("first") - 1] == f"#line {LINES_PER_FILE + 1}"
    assert lines[lines.index("inner") - 1] == f"#line {2 * LINES_PER_FILE + 1}"
    assert lines[lines.index("third") - 1] == f"#line {LINES_PER_FILE + 3}"


@pytest.mark.parametrize(
    "log",
    [
        "0:20017(5): error: `x' undeclared",
        "0(20017) : error C1503: undefined variable",
        "ERROR: 0:20017: 'x' : undeclared",
    ],
    ids=["mesa", "nvidia", "apple"],
)
def test_a_drivers_message_is_told_with_our_file_and_line(
    monkeypatch: pytest.MonkeyPatch, log: str
) -> None:
    fake_files(monkeypatch, a='#include "b.glsl"', b="inner")
    told = compose("a.glsl").explain(f"GLSL Compiler failed\n{log}\n0:20018(1): warning: dull\n")
    assert told.startswith("b.glsl:17: ")
    assert "warning" not in told


def test_a_message_without_errors_is_told_as_it_is() -> None:
    assert compose("rect.vert").explain(" out of registers \n") == "out of registers"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('#include "nowhere.glsl"', r"'nowhere\.glsl', wanted by a\.glsl:1, does not exist"),
        ('#include "../secret.glsl"', "does not exist"),
        ("#include NOTHING", r"a\.glsl:1: nothing generated for NOTHING"),
        ("#include <angle>", "not an include"),
    ],
)
def test_an_unknown_name_is_an_error_that_names_the_place(
    monkeypatch: pytest.MonkeyPatch, text: str, message: str
) -> None:
    fake_files(monkeypatch, a=text)
    with pytest.raises(ShaderError, match=message):
        compose("a.glsl")


@pytest.mark.parametrize("name", ["absent.frag", "../errors.py", "/etc/passwd", "MESH.VERT"])
def test_only_shaders_of_the_package_are_read(name: str) -> None:
    with pytest.raises(ShaderError, match="does not exist"):
        compose(name)


def test_includes_that_nest_too_deeply_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = {f"f{i}": f'#include "f{i + 1}.glsl"' for i in range(MAX_DEPTH + 2)}
    fake_files(monkeypatch, **chain)
    with pytest.raises(ShaderError, match=f"deeper than {MAX_DEPTH}"):
        compose("f0.glsl")


@pytest.mark.parametrize("spec", [TOY.spec, NARROW], ids=["paper", "narrow"])
def test_packed_weights_come_back(spec: AvatarSpec) -> None:
    tensors = make_toy_avatar(spec=spec, grid=4).tensors
    unpacked = unpack_weights(spec, pack_weights(spec, tensors))
    assert unpacked.keys() == {
        name for name in tensors if re.match(r"(xyz|pixel)\.\d+\.(weight|bias)$", name)
    }
    for name, array in unpacked.items():
        np.testing.assert_array_equal(array, tensors[name], err_msg=name)


def test_the_papers_networks_fill_20_matrices_and_9_vectors() -> None:
    assert block_sizes(TOY.spec) == (20, 9)
    assert len(pack_weights(TOY.spec, TOY.tensors)) == 4 * (20 * 16 + 9 * 4)


def test_padding_is_zero_so_a_sine_layer_keeps_it_zero() -> None:
    tensors = make_toy_avatar(spec=NARROW, grid=4).tensors
    floats = np.frombuffer(pack_weights(NARROW, tensors), np.float32)
    used = sum(
        tensors[f"{block.name}.{part}"].size
        for block in layer_blocks(NARROW)
        for part in ("weight", "bias")
    )
    assert np.count_nonzero(floats) == used


def test_constants_name_weights_exactly() -> None:
    text = siren_source(TOY.spec, TOY.tensors)
    assert "uniform" not in text
    written = {np.float32(number) for number in re.findall(r"-?\d\.\d{8}e[+-]\d\d", text)}
    assert {np.float32(value) for value in TOY.tensors["pixel.3.weight"].ravel()} <= written
