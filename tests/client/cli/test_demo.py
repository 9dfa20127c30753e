"""What `pica demo` makes of the numbers of its call."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pica_client.cli import demo
from pica_command.main import main

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(("drawn", "status"), [(15, 0), (14, 1), (0, 1)])
def test_a_demo_that_did_not_draw_everybody_ends_with_one_and_says_what_helps(
    drawn: int,
    status: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    stats: dict[str, Any] = {"peers": 15, "rendered_peers": drawn, "render_fps": 10.0}
    stats |= {"gl_renderer": "none", "latency_ms": {"p50": 1, "p99": 2}, "errors": 0}
    monkeypatch.setattr(demo, "run_demo", lambda config: stats)
    assert main(["demo", "--headless", "--out", str(tmp_path)]) == status
    said = capsys.readouterr().err
    assert f"{drawn} of 15 peers drawn" in said
    assert ("more --seconds or fewer --peers" in said) == (status == 1)
