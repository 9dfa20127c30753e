"""A sheet of pictures as they were shown, each with its difference from what it should be."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image as Pillow
from PIL import ImageDraw

from pica_client.output import writing
from pica_core.types import Image

COLUMNS = 4
CAPTION_PX = 16
AMPLIFIED = 8
"""Factor on differences, so that 4 of 255 can be seen."""


class Cell(NamedTuple):
    """One picture as it was shown and as it should be."""

    caption: str
    wanted: Image
    """uint8 ``[H, W, 3]``."""
    shown: Image


def write_sheet(path: Path, cells: Sequence[Cell], columns: int = COLUMNS) -> None:
    """Write the sheet as PNG: each picture above its difference, captions on top.

    Args:
        cells: All of one size.

    Raises:
        OptionError: The file cannot be written.
    """
    height, width = cells[0].shown.shape[:2]
    tall = CAPTION_PX + 2 * height
    rows = -(-len(cells) // columns)
    sheet = Pillow.new("RGB", (columns * width, rows * tall), (24, 26, 30))
    pen = ImageDraw.Draw(sheet)
    for index, cell in enumerate(cells):
        x, y = index % columns * width, index // columns * tall
        difference = AMPLIFIED * np.abs(cell.shown.astype(np.int16) - cell.wanted)
        pen.text((x + 4, y + 2), cell.caption, fill=(225, 225, 225))
        sheet.paste(Pillow.fromarray(cell.shown), (x, y + CAPTION_PX))
        shade = Pillow.fromarray(np.minimum(difference, 255).astype(np.uint8))
        sheet.paste(shade, (x, y + CAPTION_PX + height))
    with writing(path):
        sheet.quantize(256).save(path, optimize=True)  # a third of the bytes
