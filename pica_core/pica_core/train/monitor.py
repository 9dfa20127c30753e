"""What a run tells about itself: lines of JSON, pictures, and the same for TensorBoard."""

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from PIL import Image

from pica_core.types import ByteArray

logger = logging.getLogger(__name__)

METRICS = "metrics.jsonl"


class Monitor:
    """Writes ``metrics.jsonl`` and ``pictures/STEP.png`` into a run's folder, and the same into
    ``board/`` for TensorBoard; nothing if it is silent, because another process does."""

    def __init__(self, run_dir: Path, *, is_silent: bool = False) -> None:
        self._run_dir, self._is_silent = run_dir, is_silent
        if not is_silent:
            # Loaded only here: it takes seconds that readers of runs do not owe.
            from torch.utils.tensorboard import SummaryWriter

            self._file = (run_dir / METRICS).open("a")
            self._board = SummaryWriter(run_dir / "board")

    def close(self) -> None:
        """Close all files."""
        if not self._is_silent:
            self._file.close()
            self._board.close()

    def row(self, step: int, kind: str, values: Mapping[str, Any]) -> None:
        """Write a line; its numbers become curves."""
        if self._is_silent:
            return
        self._file.write(json.dumps({"step": step, "kind": kind, **values}) + "\n")
        self._file.flush()
        for name, value in values.items():
            if isinstance(value, int | float):
                self._board.add_scalar(f"{kind}/{name}", value, step)

    def note(self, step: int, text: str) -> None:
        """Say something once, in the file and in the log."""
        if not self._is_silent:
            logger.warning("step %d: %s", step, text)
            self.row(step, "note", {"text": text})

    def picture(self, step: int, image: ByteArray) -> None:
        """Keep a picture, uint8 ``[H, W, 3]``."""
        if self._is_silent:
            return
        folder = self._run_dir / "pictures"
        folder.mkdir(exist_ok=True)
        Image.fromarray(image).save(folder / f"{step:07d}.png")
        self._board.add_image("held out", image, step, dataformats="HWC")
