"""Shaders as text: includes, sizes, weights, and messages that point at our files."""

from __future__ import annotations

import re

import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_client.render import gpu_program
from pica_client.render.gpu_program import LINES_PER_FILE, compose
from pica_client.render.gpu_tables import pack_weights, siren_source
from pica_core.avatar.spec import ENCODINGS, AvatarSpec

pytestmark = pytest.mark.unit

TOY = make_toy_avatar(grid=4)


def fake_files(monkeypatch: pytest.MonkeyPatch, **texts: str) -> None:
    files = {f"{name}.glsl": text for name, text in texts.items()}
    monkeypatch.setattr(gpu_program, "_read", lambda name: files[name])


def test_lines_are_numbered_by_file(monkeypatch: pytest.MonkeyPatch) -> None:
    fake_files(monkeypatch, a='first\n#include "b.glsl"\nthird', b="inner")
    lines = compose("a.glsl").text.splitlines()
    assert lines == [
        "#version 330 core",
        f"#line {LINES_PER_FILE + 1}",
        "first",
        f"#line {2 * LINES_PER_FILE + 1}",
        "inner",
        f"#line {LINES_PER_FILE + 3}",
        "third",
    ]


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


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_encoding_gives_the_decoder_its_sizes_and_vectors(encoding: str) -> None:
    spec = AvatarSpec(encoding=encoding)
    generated = {"siren.glsl": siren_source(spec)}
    text = compose("pixel_decoder.frag", spec, generated=generated).text
    assert f"#define AXIS_SIZE {spec.axis_encoding_size}\n" in text
    (codes,) = re.findall(r"^#define SURFACE_CODES\b(.*)$", text, re.MULTILINE)
    assert codes.count("(") == -(-spec.pixel_input_channels // 4) - 2


def test_the_papers_networks_fill_20_matrices_and_9_vectors() -> None:
    matrices, biases = pack_weights(TOY.spec, TOY.tensors)
    assert (matrices.shape, biases.shape) == ((20, 4, 4), (9, 4))


def test_constants_name_weights_exactly() -> None:
    text = siren_source(TOY.spec, TOY.tensors)
    assert "uniform" not in text
    written = {np.float32(number) for number in re.findall(r"-?\d\.\d{8}e[+-]\d\d", text)}
    assert {np.float32(value) for value in TOY.tensors["pixel.3.weight"].ravel()} <= written
