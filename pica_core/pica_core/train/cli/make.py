"""`pica avatar make`: from a scan of a head to an avatar that joins a call."""

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.stage.synth import RenderOptions
from pica_core.cli import MeChoices, make_head, render_me
from pica_core.errors import check_ranges
from pica_core.files import FOLDERS
from pica_core.train.cli.train import ExportOptions, TrainOptions, export, train
from pica_core.train.export import EVALUATION_FILE
from pica_core.train.train import CHECKPOINT

STAGE = RenderOptions(frames=256, cameras=10, size="384x384")
"""What is rendered of a fitted head (that of docs/avatars.md, whose seconds are known)."""
DRAFT = replace(STAGE, frames=24, cameras=5, size="192x192")
MINUTES = {"fit": 0.5, "capture": 3.8, "train": 4.7, "export": 1.6}
"""What the steps take on two quiet cores: of people measured (docs/avatars.md), the fit alone of a
scan."""


@dataclass(frozen=True, kw_only=True, slots=True)
class MakeOptions(MeChoices):
    """Options of `pica avatar make`."""

    name: str
    """Name to show in a call."""
    draft: bool = False
    """Make a blurred one first, in minutes, in the folder draft of the other's."""
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
    folder = options.out or FOLDERS.user_data_path / "me" / slug
    work, stage = (folder / "draft", DRAFT) if options.draft else (folder, STAGE)
    file = work / f"{slug}.pica"
    seconds: dict[str, float] = {}

    @contextmanager
    def step(name: str) -> Iterator[None]:
        number, begun = len(seconds) + 1, time.monotonic()
        left = sum(list(MINUTES.values())[number - 1 :])
        told = "a draft" if options.draft else f"about {left:.0f} minutes left in all"
        console.print(f"[{number}/{len(MINUTES)}] {name}: {told}")
        yield
        seconds[name] = round(time.monotonic() - begun, 1)

    with step("fit"):
        head = make_head(options, folder, console)
    capture, run = work / "capture", work / "run"
    with step("capture"):
        if not (capture / "capture.json").exists():
            render_me(console, head, stage, capture)
    with step("train"):
        if not (run / EVALUATION_FILE).exists():
            resume = (run / CHECKPOINT).exists()
            wanted = TrainOptions(capture=capture, out=run, resume=resume, threads=options.threads)
            train(replace(wanted, preset="tiny" if options.draft else "own"))
    with step("export"):
        if not file.exists():
            licence = str(Capture.open(capture).info["licence"])
            wish = ExportOptions(run=run, capture=capture, out=file, name=options.name)
            export(replace(wish, licence=licence, threads=options.threads))
    console.print(f"Begin a call with it:\n\n    pica demo --avatar {file}\n", soft_wrap=True)
    return {"path": str(file), "folder": str(folder), "seconds": seconds}
