import pytest

from pica_client.voice.opus import available

pytest.importorskip("pesq", reason="extra bench")

from pica_client.avatars.library import AvatarLibrary
from pica_client.bench.voice import BenchVoiceConfig, run_bench_voice

pytestmark = [pytest.mark.render, pytest.mark.skipif(available() is not None, reason="no libopus")]


def test_a_clean_voice_is_clear_and_fresh_and_a_stalled_one_in_step_with_its_face():
    library = AvatarLibrary()
    avatar = library.load(library.find("Amara"))
    config = BenchVoiceConfig(scenarios=("jitter-0", "stall-300"), seconds=12)
    clean, stalled = run_bench_voice(config, avatar)["rows"]

    assert clean["pesq"] >= 3.4
    assert clean["mouth_to_ear_ms"]["p95"] <= 120
    assert clean["concealed_ratio"] == 0
    assert clean["face_mse"] < 4
    assert clean["face_still_ms"] <= 67
    # 300 ms of silence, less what the voice waits.
    assert 150 < stalled["face_still_ms"] < 350
    for row in (clean, stalled):
        assert row["skew_ms"]["p95"] <= 40
