"""`pica bench voice`."""

from typing import Any

from pica_client.bench.voice import BenchVoiceConfig, run_bench_voice
from pica_client.cli.bench.avatars import AvatarBenchOptions


def bench_voice(options: AvatarBenchOptions[BenchVoiceConfig]) -> dict[str, Any]:
    """Measure what arrives of a voice and its face on troubled networks: quality, delay, lip-sync.

    Runs on a virtual clock and needs neither network nor sound card.
    """
    return run_bench_voice(options.config, options.load())
