"""`pica avatar make`: from a scan of a head to an avatar that joins a call."""

import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from platformdirs import PlatformDirs
from rich.console import Console

from pica_core.capture.stage.synth import RenderOptions
from pica_core.cli import MeChoices, make_head, render_me
from pica_core.errors import check_ranges
from pica_core.train.cli.train import ExportOptions, TrainOptions, export, train
from pica_core.train.export import EVALUATION_FILE
from pica_core.train.train import CHECKPOINT

STAGE = RenderOptions(frames=256, cameras=10, size="384x384")
"""What is rendered of a fitted head (that of docs/avatars.md, whose seconds are known)."""
LICENCE = "of the person shown; face model ICT-FaceKit: MIT, (c) 2020 USC ICT"
MINUTES = {"fit": 0.5, "capture": 3.8, "train": 3.3, "export": 1.6}
"""What the steps take on two quiet cores: of people measured (docs/avatars.md), the fit alone of a
scan."""


@dataclass(frozen=True, kw_only=True, slots=True)
class MakeOptions(MeChoices):
    """Options of `pica avatar make`."""

    name: str
    """Name to show in a call."""
    out: Path | None = None
    """Folder for the avatar and what it is made of; by default one of the user's data folder. What
    is finished there is not made again."""
    threads: int = 2
    """CPU threads of training."""

    def __post_init__(self) -> None:
        check_ranges(self, threads=(1, 1024))


def avatar_make(options: MakeOptions) -> dict[str, Any]:
    """Make an avatar of yourself from a scan of your head: fit, render, train, export."""
    console = Console(stderr=True, highlight=False)
    slug = re.sub(r"[^a-z0-9]+", "-", options.name.lower()).strip("-") or "me"
    folder = options.out or _folders().user_data_path / "me" / slug
    file = folder / f"{slug}.pica"
    left = sum(MINUTES.values())
    seconds: dict[str, float] = {}

    def begin(step: str) -> None:
        nonlocal left
        number = len(seconds) + 1
        console.print(f"[{number}/{len(MINUTES)}] {step}: about {left:.0f} minutes left in all")
        left -= MINUTES[step]
        seconds[step] = -time.monotonic()

    def end(step: str) -> None:
        seconds[step] = round(seconds[step] + time.monotonic(), 1)

    begin("fit")
    head = make_head(options, folder, console)
    end("fit")
    begin("capture")
    capture, run = folder / "capture", folder / "run"
    if not (capture / "capture.json").exists():
        render_me(console, head, STAGE, capture)
    end("capture")
    begin("train")
    if not (run / EVALUATION_FILE).exists():
        resume = (run / CHECKPOINT).exists()
        train(
            TrainOptions(
                capture=capture, out=run, preset="small", resume=resume, threads=options.threads
            )
        )
    end("train")
    begin("export")
    if not file.exists():
        export(
            ExportOptions(
                run=run, capture=capture, out=file, name=options.name, licence=LICENCE,
                threads=options.threads,
            )
        )  # fmt: skip
    end("export")
    console.print(f"Begin a call with it:\n\n    pica demo --avatar {file}\n", soft_wrap=True)
    return {"path": str(file), "folder": str(folder), "seconds": seconds}


def _folders() -> PlatformDirs:
    return PlatformDirs("pica-telepresence", appauthor=False, roaming=True)
