"""The page with people of a test in it: what is shown, and what buttons and keys do."""

import json
from typing import Any

import numpy as np
import pytest

from helpers.browser import PAGES, WEB, run_page
from pica_client.sources.source import make_performance
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar, shipped_avatar_files

pytestmark = pytest.mark.render
NORA = next(path for path in shipped_avatar_files() if path.stem == "nora")


def _faces() -> bytes:
    """A second of Nora talking."""
    performance, encoder = make_performance("talk", seed=1), ExpressionEncoder(load_avatar(NORA))
    rows = []
    for number in range(30):
        face = performance.frame_at(number / 30)
        latent = encoder.encode(face.arkit).ravel()
        rows.append(np.concatenate([latent, face.rotation, face.translation_m]))
    return np.array(rows, np.float32).tobytes()


def _open(people: list[dict[str, Any]], path: str, *, is_tile: bool) -> Any:
    script = '<script type="module" src="web/drive.js"></script></head>'
    index = (WEB / "index.html").read_text().replace("</head>", script)
    files = {
        "index.html": index.encode(),
        "call.js": (PAGES / "fake_call.js").read_bytes(),
        "people.json": json.dumps(people).encode(),
        "case.json": json.dumps({"isTile": is_tile}).encode(),
        "nora.pica": NORA.read_bytes(),
        "broken.pica": NORA.read_bytes()[:5000],
        **{f"{number}.faces": _faces() for number in range(len(people))},
    }
    return run_page(path, files, flags=("--window-size=480,360",))[1]


def test_people_are_shown_named_and_pinned() -> None:
    people = [
        {"name": "Nora", "avatar": "nora"},
        {"name": "Ben", "avatar": "broken"},
        {"name": "W" * 64, "avatar": None, "state": "not encrypted · muted"},
    ]
    found = _open(people, "demo", is_tile=False)
    assert found["first"][0]["text"] == "Nora"
    assert found["first"][1]["text"].startswith("Benthis is no avatar")
    assert found["first"][2]["text"] == "W" * 64 + "not encrypted · muted"
    assert [each["isFaceless"] for each in found["first"]] == [False, True, True]
    assert [each["isSpeaking"] for each in found["first"]] == [True, False, False]
    assert [each["isPinned"] for each in found["pinned"]] == [True, False, False]
    assert found["layout"] == "Layout: table"
    assert found["mute"]
    assert found["isHealed"]
    assert found["unlabelled"] == 0
    assert found["problem"]


def test_a_tile_is_one_person_on_a_transparent_ground() -> None:
    people = [{"name": "Ben", "avatar": None}, {"name": "Nora", "avatar": "nora"}]
    found = _open(people, "demo?tile=Nora&background=transparent", is_tile=True)
    assert {0, 255} <= set(found["alphas"])
    assert not found["isBarShown"]
