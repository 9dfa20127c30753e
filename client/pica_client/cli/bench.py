"""The commands of `pica bench` that measure avatars."""

from contextlib import closing
from dataclasses import dataclass
from typing import Any

from pica_client.avatars.library import AvatarLibrary
from pica_client.bench.decode import DecodeBenchConfig, run_decode_bench
from pica_client.bench.drive import DriveBenchConfig, run_drive_bench
from pica_client.bench.harness import say_rows
from pica_client.bench.scene import SceneBenchConfig, run_scene_bench
from pica_client.bench.voice import BenchVoiceConfig, run_bench_voice
from pica_client.local_call.local_call import choose_avatars
from pica_core.avatar.file import Avatar

Result = dict[str, Any]


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarChoice:
    """Avatars that a bench measures."""

    avatar: str | None = None
    """Names of shipped avatars or .pica files, separated by commas; by default all that ship. All
    benches but drive and scene measure the first alone."""

    def load(self) -> list[Avatar]:
        """The avatars that are measured."""
        with closing(AvatarLibrary()) as library:
            return [
                library.load(library.find(name)) for name in choose_avatars(self.avatar, library)
            ]


def bench_decode(avatars: AvatarChoice, options: DecodeBenchConfig) -> Result:
    """Measure what decoding and drawing one head costs, beside the paper's baseline.

    Set LP_NUM_THREADS to choose how many threads software GL takes.
    """
    result = run_decode_bench(options, avatars.load()[0])
    say_rows(
        result["rows"],
        "work model level parts distance_cm ms p95 spread pixels triangles over_baseline",
    )
    return result


def bench_drive(avatars: AvatarChoice, options: DriveBenchConfig) -> Result:
    """Measure what a driven face becomes at every level: picture, lids, lips.

    The truth is the person or the rig itself, at the same values.
    """
    result = run_drive_bench(options, avatars.load())
    say_rows(result["rows"], "avatar source level wire_bps mse lid_mm lip_mm")
    return result


def bench_scene(avatars: AvatarChoice, options: SceneBenchConfig) -> Result:
    """Measure a scene of talking heads: its cost, and the error that the scheduler leaves.

    Avatars are dealt to the heads in turn. Set LP_NUM_THREADS to say how many threads software GL
    takes.
    """
    result = run_scene_bench(options, avatars.load())
    say_rows(
        result["rows"],
        "avatars distance_cm scheduler total_ms decode_ms upload_ms draw_ms plan_ms error",
    )
    say_rows(
        result["summary"]["scenes"],
        "distance_cm scheduled_over_full_screen unscheduled_over_full_screen error",
    )
    return result


def bench_voice(avatars: AvatarChoice, options: BenchVoiceConfig) -> Result:
    """Measure what arrives of a voice and its face on troubled networks: quality, delay, lip-sync,
    the error of the picture.

    Runs on a virtual clock and needs neither network nor sound card.
    """
    return run_bench_voice(options, avatars.load()[0])
