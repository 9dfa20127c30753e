"""Recordings of the Live Link Face app: the CSV file it saves next to each take, read and written.

One header line ``Timecode,BlendShapeCount,EyeBlinkLeft,…``, then one line per tracked frame.
Columns are found by name (the app writes JawRight before JawLeft, the reverse of its UDP order),
values are about [0, 1], timecodes are ``HH:MM:SS:FF.fff`` with FF counted at 60 a second whatever
the frame rate. While there is no face a line may end after its BlendShapeCount of 0. Spreadsheets
of some countries write semicolons and decimal commas.
"""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path

import numpy as np

from pica_core.avatar.arkit import ARKIT_NAMES, NUM_ARKIT
from pica_core.errors import CaptureError
from pica_core.types import BoolArray, Float64Array

TIMECODE_FPS = 60.0
DAY_S = 24 * 3600.0
MAX_ROWS = 1_000_000
"""Longest recording that is read into memory (chosen: 4.6 hours at 60 fps, about 240 MiB)."""
MAX_HEADER = 65_536
"""Longest header, characters (the app's has 1,000)."""
ANGLES = ("HeadYaw", "HeadPitch", "HeadRoll")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LiveLinkTake:
    """What such a file holds.

    Attributes:
        clock_s: Time of day of each line, seconds. float64 ``[T]``.
        arkit: Values in `ARKIT_NAMES` order, 0 without a face. float64 ``[T, 52]``.
        angles: Yaw, pitch and roll of the head, radians; 0 where the file has none. ``[T, 3]``.
        has_face: Where there is a face and all its values are numbers. bool ``[T]``.
        num_lost: Lines with a face whose values are not all numbers.
    """

    clock_s: Float64Array
    arkit: Float64Array
    angles: Float64Array
    has_face: BoolArray
    num_lost: int


def read_livelink_csv(path: Path) -> LiveLinkTake:
    """Read a recording.

    Raises:
        CaptureError: No such file, not such a file, missing columns, or a cut or unreadable line.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            first = file.readline(MAX_HEADER)
            mark = ";" if ";" in first else ","
            table = csv.reader(chain([first], file), delimiter=mark)
            header, *rows = islice(table, MAX_ROWS + 2)
            if mark == ";":
                rows = [[value.replace(",", ".") for value in row] for row in rows]
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise CaptureError(f"{path}: is not a CSV text file ({error})") from error
    except ValueError:
        header, rows = [], []
    place = {name.strip().lower(): index for index, name in enumerate(header)}
    wanted = ("Timecode", "BlendShapeCount", *ARKIT_NAMES)
    if missing := [name for name in wanted if name.lower() not in place]:
        raise CaptureError(
            f"{path}: lacks {len(missing)} of {len(wanted)} columns ({', '.join(missing[:3])}, "
            "...); a Live Link Face CSV in ARKit mode is needed"
        )
    while rows and not rows[-1]:
        rows.pop()  # how many tools close a file
    if not 0 < len(rows) <= MAX_ROWS:
        raise CaptureError(f"{path}: has {len(rows)} frames; 1 to {MAX_ROWS:,} are allowed")
    time_column, count_column, *columns = (place[name.lower()] for name in wanted)
    columns += [place[name.lower()] for name in ANGLES if name.lower() in place]
    clock_s = np.empty(len(rows))
    values = np.zeros((len(rows), NUM_ARKIT + len(ANGLES)))
    has_face = np.zeros(len(rows), np.bool_)
    for index, row in enumerate(rows):
        where = f"{path}, line {index + 2}"
        is_lost = len(row) > count_column and row[count_column].strip() == "0"
        if len(row) != len(header) and not is_lost:
            raise CaptureError(
                f"{where}: has {len(row)} of {len(header)} values; the file was cut or edited, "
                "remove the line or export the take again"
            )
        clock_s[index] = _seconds(row[time_column], where)
        if not is_lost:
            try:
                values[index, : len(columns)] = [float(row[column]) for column in columns]
            except ValueError as error:
                raise CaptureError(f"{where}: {error}; every value must be a number") from error
            has_face[index] = True
    is_number = np.isfinite(values).all(axis=1)
    values[~is_number] = 0.0
    return LiveLinkTake(
        clock_s=clock_s,
        arkit=values[:, :NUM_ARKIT],
        angles=values[:, NUM_ARKIT:],
        has_face=has_face & is_number,
        num_lost=int(np.count_nonzero(~is_number)),
    )


def livelink_csv(rows: Iterable[tuple[float, Sequence[float] | None]]) -> str:
    """A recording as such a file, whose clock begins at midnight.

    Args:
        rows: Seconds, and the 52 values with yaw, pitch and roll, radians; None without a face.
            What does not come later than the row before is left out.
    """
    lines = [",".join(("Timecode", "BlendShapeCount", *ARKIT_NAMES, *ANGLES))]
    before = -1
    for time_s, values in rows:
        thousandths = round(time_s * TIMECODE_FPS * 1000)
        if thousandths <= before:
            continue
        before = thousandths
        seconds, frame = divmod(thousandths / 1000, TIMECODE_FPS)
        hours, minutes = divmod(int(seconds) // 60, 60)
        timecode = f"{hours:02}:{minutes:02}:{int(seconds) % 60:02}:{frame:06.3f}"
        numbers = ["0"] if values is None else [str(NUM_ARKIT), *(f"{v:.6f}" for v in values)]
        lines.append(",".join((timecode, *numbers)))
    return "\n".join(lines) + "\n"


def _seconds(timecode: str, where: str) -> float:
    """``HH:MM:SS:FF.fff`` as seconds since midnight."""
    try:
        hours, minutes, seconds, frames = timecode.split(":")
        clock_s = int(hours) * 3600 + int(minutes) * 60 + int(seconds)
        frame_s = float(frames) / TIMECODE_FPS
    except ValueError:
        clock_s, frame_s = -1, 0.0
    if not (0 <= clock_s < DAY_S and 0 <= frame_s < 2):
        raise CaptureError(f"{where}: timecode {timecode!r} is not HH:MM:SS:FF.fff")
    return clock_s + frame_s
