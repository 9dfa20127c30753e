"""The page's modules are typed by JSDoc, and small."""

import subprocess
from pathlib import Path

import pytest

from helpers.page import node_module
from helpers.paths import ROOT

pytestmark = pytest.mark.unit

HERE = Path(__file__).parent
WEB = ROOT / "server" / "pica_server" / "web"
KINDS = {".js", ".ts", ".html", ".css"}
LATER = ("camera", "face", "finder", "live_face", "networks", "pulse", "upload", "xr")
"""What is loaded when it is asked for: one's own face, a camera, a headset."""
MAX_LINES, MAX_BYTES = 5_169, 222_000
MAX_LATER_LINES, MAX_LATER_BYTES = 1_132, 50_200


def test_modules_are_typed() -> None:
    tsc = node_module(".bin/tsc")
    found = subprocess.run(
        [tsc, "--project", HERE], capture_output=True, text=True, check=False, timeout=60
    )
    assert not found.returncode, found.stdout


def test_the_page_is_small() -> None:
    files = {each.name: each.read_text() for each in WEB.iterdir() if each.suffix in KINDS}
    later = [files.pop(f"{name}.js") for name in LATER]
    for texts, max_lines, max_bytes in (
        (files.values(), MAX_LINES, MAX_BYTES),
        (later, MAX_LATER_LINES, MAX_LATER_BYTES),
    ):
        assert sum(text.count("\n") for text in texts) <= max_lines
        assert sum(len(text.encode()) for text in texts) <= max_bytes
