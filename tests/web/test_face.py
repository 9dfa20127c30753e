"""A face that a voice moves: the page's mouth and encoder are Python's."""

import base64
import json

import numpy as np
import pytest

from helpers.page import Handle, Page
from pica_client.voice.mouth import MouthFromVoice
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar, shipped_avatar_files
from pica_server.pages import avatar_names, page_files

pytestmark = pytest.mark.unit


def test_a_mouth_moves_as_pythons_does(page: Page) -> None:
    weights = {
        name: {
            "shape": each["shape"],
            "values": np.frombuffer(base64.b64decode(each["halfs"]), "<f2").astype(np.float32),
        }
        for name, each in json.loads(page_files()["mouth.json"]).items()
    }
    time_s = np.arange(24_000) / 48_000
    syllables = 0.5 + 0.5 * np.sin(2 * np.pi * 4 * time_s)
    sound = 0.3 * syllables * np.sin(2 * np.pi * 150 * time_s + 3 * np.sin(2 * np.pi * 5 * time_s))
    pcm = np.asarray(sound, np.float32)
    mouth: Handle = page.call("face", "Mouth", weights)
    found = np.array([mouth.push(hop) for hop in pcm.reshape(-1, 480)])
    expected = MouthFromVoice().push(pcm)
    assert expected.max() > 0.1
    assert found == pytest.approx(expected, abs=2e-3)


def test_shapes_become_the_latent_of_an_avatar(page: Page) -> None:
    path = shipped_avatar_files()[0]
    avatar = load_avatar(path)
    arkit = np.random.default_rng(2).uniform(0, 1, 52).astype(np.float32)
    layers = {
        f"encoder.{index}.{kind}": avatar.tensors[f"encoder.{index}.{kind}"]
        for index in range(3)
        for kind in ("weight", "bias")
    }
    encoder: Handle = page.call("latent_stream", "openEncoder", {"floats": {"lookup": layers}})
    assert np.array(encoder.call(None, arkit)) == pytest.approx(
        ExpressionEncoder(avatar).encode(arkit).ravel(), abs=1e-4
    )


def test_the_avatars_that_ship_are_offered_by_name() -> None:
    names = [path.stem.capitalize() for path in shipped_avatar_files()]
    assert list(avatar_names()) == names
