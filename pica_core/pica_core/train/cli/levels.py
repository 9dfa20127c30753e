"""`pica avatar levels`: give an avatar file levels of detail."""

import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from pica_core.avatar.file import avatar_id, load_avatar, save_avatar
from pica_core.avatar.shipped import avatar_file
from pica_core.errors import TrainingOptionError, check_ranges
from pica_core.train.lod.levels import LevelOptions, LevelReport, add_levels


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarLevelsOptions:
    """Options of `pica avatar levels`."""

    file: Path = field(kw_only=False)
    """Name of a shipped avatar, or a .pica file; neither its capture nor its run is needed."""
    out: Path
    """The avatar file to write; may be the same."""
    levels: LevelOptions = field(default_factory=LevelOptions)
    threads: int = 2
    """CPU threads of torch."""

    def __post_init__(self) -> None:
        check_ranges(self, TrainingOptionError, threads=(1, 1024))


def avatar_levels(options: AvatarLevelsOptions) -> dict[str, Any]:
    """Fit early exits and coarser meshes to an avatar; its full model stays as it is."""
    file = avatar_file(options.file)
    avatar = load_avatar(file)
    torch.set_num_threads(options.threads)
    levelled, reports = add_levels(
        avatar, options.levels, lambda text: print(text, file=sys.stderr)
    )
    save_avatar(options.out, levelled, like=file)
    for report in reports:
        print(describe(report), file=sys.stderr)
    return {
        **written(options.out),
        "id": avatar_id(options.out),
        "levels": [asdict(report) for report in reports],
    }


def written(path: Path) -> dict[str, Any]:
    """Say where a file is and how large."""
    size = path.stat().st_size
    print(f"{path}: {size / 1e6:.2f} MB", file=sys.stderr)
    return {"path": str(path), "bytes": size}


def describe(report: LevelReport) -> str:
    """One line about a level."""
    return (
        f"level {report.level}: {report.triangles} triangles, vertices off by "
        f"{report.vertex_error_mm:.2f} mm (p99 {report.vertex_error_p99_mm:.2f}; a still face "
        f"{report.vertex_rest_mm:.2f}), colours by {report.colour_mse:.1f} MSE "
        f"(0-255; a still map {report.colour_still_mse:.1f})"
    )
