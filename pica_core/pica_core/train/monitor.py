"""What a run tells about itself: lines of JSON, pictures, and the same for TensorBoard."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image

from pica_core.types import ByteArray

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

logger = logging.getLogger(__name__)

METRICS = "metrics.jsonl"


class Monitor:
    """Writes ``metrics.jsonl`` and ``pictures/STEP.png`` into a run's folder, and the same into
    ``board/`` for TensorBoard.

    Args:
        is_silent: Write nothing: another process does.
    """

    def __init__(self, run_dir: Path, *, is_silent: bool = False) -> None:
        self._run_dir = run_dir
        self._file = None if is_silent else (run_dir / METRICS).open("a")
        self._board = None if is_silent else _open_board(run_dir / "board")

    def close(self) -> None:
        """Close all files."""
        if self._file is not None:
            self._file.close()
        if self._board is not None:
            self._board.close()

    def row(self, step: int, kind: str, values: Mapping[str, Any]) -> None:
        """Write a line; its numbers become curves."""
        if self._file is None or self._board is None:
            return
        self._file.write(json.dumps({"step": step, "kind": kind, **values}) + "\n")
        self._file.flush()
        for name, value in values.items():
            if isinstance(value, int | float):
                self._board.add_scalar(f"{kind}/{name}", value, step)

    def note(self, step: int, text: str) -> None:
        """Say something once, in the file and in the log."""
        if self._file is not None:
            logger.warning("step %d: %s", step, text)
            self.row(step, "note", {"text": text})

    def picture(self, step: int, image: ByteArray) -> None:
        """Keep a picture, uint8 ``[H, W, 3]``."""
        if self._board is None:
            return
        folder = self._run_dir / "pictures"
        folder.mkdir(exist_ok=True)
        Image.fromarray(image).save(folder / f"{step:07d}.png")
        self._board.add_image("held out", image, step, dataformats="HWC")


def _open_board(folder: Path) -> SummaryWriter:
    """A TensorBoard writer, loaded only here: it takes seconds that readers of runs do not owe."""
    from torch.utils.tensorboard import SummaryWriter

    return SummaryWriter(folder)


def curve(run_dir: Path) -> list[dict[str, Any]]:
    """What the looks at held-out frames found, {step, seconds, mse}, oldest first."""
    rows = [json.loads(line) for line in (run_dir / METRICS).read_text().splitlines()]
    return [
        {key: row[key] for key in ("step", "seconds", "mse")}
        for row in rows
        if row["kind"] == "held_out"
    ]
