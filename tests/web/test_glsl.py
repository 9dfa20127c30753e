"""The page composes the text that the Python client composes."""

from dataclasses import asdict

import pytest

from helpers.page import Page
from pica_client.render.gpu_program import compose
from pica_client.render.gpu_tables import siren_source
from pica_core.avatar.spec import ENCODINGS, AvatarSpec
from pica_server.web import shader_texts

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_pixel_decoders_are_composed_alike(page: Page, encoding: str) -> None:
    for size in (1, 1000, 10_000):
        spec = AvatarSpec(encoding=encoding, axis_encoding_size=size, uv_encoding_size=512)
        play = "../../../tests/web/play"
        found = page.call(play, "pixelDecoder", shader_texts(), asdict(spec), True)
        siren = siren_source(spec)
        assert found["siren"] == siren
        assert found["text"] == compose(
            "pixel_decoder.frag",
            spec,
            dialect="300 es",
            generated={"siren.glsl": siren},
            defines={"FILTERED": ""},
        )
