"""The demo from end to end on a real clock: every process, GL and the recording included."""

import json
from pathlib import Path

import pytest

from helpers.toy import make_toy_avatar
from pica_client.cli.demo import DemoConfig, run_demo
from pica_client.local_call.local_call import LocalCallConfig
from pica_core.avatar.file import save_avatar

pytestmark = pytest.mark.realtime

STATED_FIELDS = {
    *("peers", "rendered_peers", "seconds", "frames_rendered", "render_fps", "latents_per_s"),
    *("bitrate_bps", "latency_ms", "concealed", "errors", "gl_renderer", "machine"),
}


@pytest.fixture
def avatar_file(tmp_path: Path) -> Path:
    path = tmp_path / "toy.pica"
    save_avatar(path, make_toy_avatar())
    return path


def test_a_short_demo_draws_everybody_and_writes_its_files(
    avatar_file: Path, tmp_path: Path
) -> None:
    pytest.importorskip("av")
    out = tmp_path / "out"
    out.mkdir()
    (out / "call.mp4").write_text("of the demo before")
    stats = run_demo(
        DemoConfig(
            call=LocalCallConfig(peers=2, avatar=str(avatar_file)),
            seconds=2,
            headless=True,
            size="192x108",
            out=out,
        )
    )
    assert set(stats) >= STATED_FIELDS
    assert json.loads((out / "stats.json").read_text()) == stats
    assert (stats["peers"], stats["rendered_peers"], stats["errors"]) == (2, 2, 0)
    assert set(stats["latency_ms"]["parts"]) == {*("decode_wait", "decode", "upload", "draw")}
    assert stats["latency_ms"]["p99"] > 0
    assert all(rate > 0 for rate in stats["latents_per_s"].values())
    assert (out / "call.mp4").stat().st_size > 1000
    assert (out / "frame.png").read_bytes().startswith(b"\x89PNG")
