"""Shaders as text: includes, sizes, weights, and messages that point at our files."""

from __future__ import annotations

import re

import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_client.render import gpu_program
from pica_client.render.gpu_program import complaint, compose
from pica_client.render.gpu_tables import pack_weights, siren_source
from pica_core.avatar.spec import ENCODINGS, AvatarSpec

pytestmark = pytest.mark.unit

TOY = make_toy_avatar(grid=4)


def fake_files(monkeypatch: pytest.MonkeyPatch, **texts: str) -> None:
    files = {f"{name}.glsl": text for name, text in texts.items()}
    monkeypatch.setattr(gpu_program, "_read", lambda name: files[name])


def test_an_include_is_replaced_by_its_text(monkeypatch: pytest.MonkeyPatch) -> None:
    fake_files(monkeypatch, a='first\n#include "b.glsl" // why\nthird', b="inner")
    lines = compose("a.glsl", defines={"WIDE": ""}).splitlines()
    assert lines == ["#version 330 core", "#define WIDE", "first", "inner", "third"]


@pytest.mark.parametrize(
    "error",
    [
        "0:2(5): error: `x' undeclared",
        "0(2) : error C1503: undefined variable",
        "ERROR: 0:2: 'x' : undeclared",
    ],
    ids=["mesa", "nvidia", "apple"],
)
def test_a_drivers_message_is_told_with_the_line_that_it_complains_of(error: str) -> None:
    log = f"GLSL Compiler failed\n0:1(1): warning: dull\n{error}\n0:3(1): error: more\n"
    assert complaint(log, "first\n  x = 1;\nthird") == f"{error} in 'x = 1;'"


def test_a_message_without_errors_is_told_as_it_is() -> None:
    assert complaint(" out of registers \n", "text") == "out of registers"


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_encoding_gives_the_decoder_its_sizes_and_vectors(encoding: str) -> None:
    spec = AvatarSpec(encoding=encoding)
    generated = {"siren.glsl": siren_source(spec)}
    text = compose("pixel_decoder.frag", spec, generated=generated)
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
