"""The page with people of a test in it: what is shown, and what buttons and keys do."""

import json
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from helpers.browser import PAGES, WEB, run_page
from helpers.page import node_module
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


def _open(
    people: list[dict[str, Any]],
    path: str,
    *,
    is_tile: bool = False,
    script: str = '<script type="module" src="web/drive.js"></script>',
    more: Mapping[str, bytes] = MappingProxyType({}),
) -> tuple[dict[str, bytes], Any]:
    index = (WEB / "index.html").read_text().replace("</head>", f"{script}</head>")
    files = {
        "index.html": index.encode(),
        "call.js": (PAGES / "fake_call.js").read_bytes(),
        "people.json": json.dumps(people).encode(),
        "case.json": json.dumps({"isTile": is_tile}).encode(),
        "nora.pica": NORA.read_bytes(),
        "broken.pica": NORA.read_bytes()[:5000],
        **more,
        **{f"{number}.faces": _faces() for number in range(len(people))},
    }
    return run_page(path, files, flags=("--window-size=480,360",))


def test_people_are_shown_named_and_pinned() -> None:
    people = [
        {"name": "Nora", "avatar": "nora"},
        {"name": "Ben", "avatar": "broken"},
        {"name": "W" * 64, "avatar": None, "state": "not encrypted · muted"},
    ]
    _, found = _open(people, "demo")
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
    _, found = _open(people, "demo?tile=Nora&background=transparent", is_tile=True)
    assert {0, 255} <= set(found["alphas"])
    assert not found["isBarShown"]


def test_a_headset_sees_people_at_a_table_at_true_scale() -> None:
    emulator = {"iwer.js": node_module("iwer/build/iwer.min.js").read_bytes()}
    _, found = _open(
        [{"name": "Nora", "avatar": "nora"}],
        "demo",
        script='<script src="web/iwer.js"></script><script src="web/emulate.js"></script>'
        '<script type="module" src="web/headset.js"></script>',
        more=emulator,
    )
    height = found["before"]["height"]
    focal_px = height / 2 / math.tan(found["fovy"] / 2)
    away_m = 1.24  # across a table of 0.62 m
    (left, right), moved, turned = (found[name]["eyes"] for name in ("before", "moved", "turned"))
    assert left["x"] - right["x"] == pytest.approx(focal_px * found["ipd"] / away_m, abs=2)
    assert left["x"] + right["x"] == pytest.approx(0, abs=6)
    for before, after, later in zip((left, right), moved, turned, strict=True):
        assert after["x"] - before["x"] == pytest.approx(-focal_px * 0.2 / away_m, abs=3)
        assert after["y"] - before["y"] == pytest.approx(-focal_px * 0.1 / away_m, abs=3)
        assert later["x"] > after["x"] + 0.9 * focal_px * math.tan(found["turned"]["angle"])
    assert found["isBack"]
