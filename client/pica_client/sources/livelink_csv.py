"""Recordings of the Live Link Face app: the CSV file it saves next to each take.

One header line ``Timecode,BlendShapeCount,EyeBlinkLeft,…``, then one line per tracked frame.
Columns are found by name (the app writes JawRight before JawLeft, the reverse of its UDP order),
values are about [0, 1], timecodes are ``HH:MM:SS:FF.fff`` with FF counted at 60 a second whatever
the frame rate.

Head angles are radians about the head's own axes (+x the subject's left, +y up, +z out of the
face). Only the order of magnitude could be checked on a real file (the recordings we have were made
with head tracking off): that yaw turns about +y, pitch about +x and roll about +z, right-handed and
in this order from the outside in, is our assumption.
"""

import csv
from itertools import islice
from pathlib import Path

import numpy as np

from pica_client.errors import SourceError
from pica_client.output import say
from pica_client.sources.live.live_face import VALUE_LIMIT
from pica_client.sources.rotation import rotation_vector_from_yaw_pitch_roll
from pica_client.sources.source import Recording
from pica_core.avatar.arkit import ARKIT_NAMES
from pica_core.types import Float64Array

TIMECODE_FPS = 60.0
"""What the last field of a timecode counts, whatever the frame rate of the take."""
DAY_S = 24 * 3600.0
MAX_ROWS = 1_000_000
"""Longest recording we read into memory (chosen: 4.6 hours at 60 fps, about 240 MiB)."""
ANGLE_COLUMNS = ("HeadYaw", "HeadPitch", "HeadRoll")


def load_livelink_csv(path: Path, *, start_s: float = 0.0) -> Recording:
    """Read a Live Link Face recording, at its own clock.

    Args:
        path: The ``.csv`` file of a take.
        start_s: Where in the recording the source begins, seconds.

    Returns:
        The looping recording. Rows with a BlendShapeCount of 0 are moments without a face, and so
        are those with values that are no numbers; of the latter the user is told.

    Raises:
        SourceError: No such file, not such a file, missing columns, a cut or unreadable row, time
            running backwards, or never a face.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(islice(csv.reader(file), MAX_ROWS + 2))
    except OSError as error:
        raise SourceError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise SourceError(f"{path}: is not a CSV text file ({error})") from error
    if not rows:
        raise SourceError(f"{path}: is empty; a Live Link Face CSV with a header line is needed")
    if len(rows) > MAX_ROWS + 1:
        raise SourceError(f"{path}: has more than {MAX_ROWS:,} frames; cut it into takes")
    columns = _find_columns(rows[0], path)
    # An empty line at the end is how many tools close a file; anywhere else it is a row cut to
    # nothing.
    body = rows[1:]
    while body and not body[-1]:
        body.pop()
    if not body:
        raise SourceError(f"{path}: has a header but no frames; record a take first")
    times_s = np.empty(len(body))
    values = np.zeros((len(body), len(ARKIT_NAMES) + len(ANGLE_COLUMNS)))
    has_face = np.ones(len(body), np.bool_)
    time_column, count_column, *value_columns = columns
    for index, row in enumerate(body):
        where = f"{path}, line {index + 2}"
        if len(row) != len(rows[0]):
            raise SourceError(
                f"{where}: has {len(row)} of {len(rows[0])} values; the file was cut or edited, "
                "remove the line or export the take again"
            )
        times_s[index] = _seconds(row[time_column], where)
        has_face[index] = row[count_column].strip() != "0"
        if has_face[index]:
            try:
                values[index] = [float(row[column]) for column in value_columns]
            except ValueError as error:
                raise SourceError(f"{where}: {error}; every value must be a number") from error
    is_number = np.isfinite(values).all(axis=1)
    if not is_number.all():
        num_lost = int((~is_number).sum())
        if num_lost == len(body):
            raise SourceError(f"{path}: no frame holds numbers alone; export the take again")
        say(f"{path}: {num_lost} of {len(body)} frames are lost, they hold NaN or infinity")
        values[~is_number], has_face[~is_number] = 0.0, False
    if not has_face.any():
        raise SourceError(f"{path}: no frame holds a face; record the take again")
    if np.abs(values).max() > VALUE_LIMIT:
        line = int(np.argmax((np.abs(values) > VALUE_LIMIT).any(axis=1))) + 2
        raise SourceError(f"{path}, line {line}: a value lies outside ±{VALUE_LIMIT:g}")
    times_s, loop_gap_s = _unroll(times_s, path)
    return Recording(
        times_s=times_s,
        arkit=values[:, : len(ARKIT_NAMES)].astype(np.float32),
        rotation=rotation_vector_from_yaw_pitch_roll(values[:, len(ARKIT_NAMES) :]),
        translation_m=np.zeros((len(body), 3), np.float32),
        has_face=has_face,
        loop_gap_s=loop_gap_s,
        start_s=start_s,
    )


def _find_columns(header: list[str], path: Path) -> list[int]:
    """Column numbers of time, count, the 52 shapes and the three head angles."""
    by_name = {name.strip().lower(): index for index, name in enumerate(header)}
    wanted = ("Timecode", "BlendShapeCount", *ARKIT_NAMES, *ANGLE_COLUMNS)
    missing = [name for name in wanted if name.lower() not in by_name]
    if missing:
        more = f" and {len(missing) - 4} more" if len(missing) > 4 else ""
        shown = ", ".join(missing[:4]) + more
        raise SourceError(
            f"{path}: lacks the columns {shown}; a Live Link Face CSV in ARKit mode is needed"
        )
    return [by_name[name.lower()] for name in wanted]


def _seconds(timecode: str, where: str) -> float:
    """``HH:MM:SS:FF.fff`` as seconds since midnight."""
    try:
        hours, minutes, seconds, frames = timecode.split(":")
        clock_s = int(hours) * 3600 + int(minutes) * 60 + int(seconds)
        frame_s = float(frames) / TIMECODE_FPS
    except ValueError:
        clock_s, frame_s = -1, 0.0
    if not (0 <= clock_s < DAY_S and 0 <= frame_s < 2):
        raise SourceError(f"{where}: timecode {timecode!r} is not HH:MM:SS:FF.fff")
    return clock_s + frame_s


def _unroll(times_s: Float64Array, path: Path) -> tuple[Float64Array, float]:
    """Times from 0, past midnight if need be, and the usual step between two samples."""
    steps_s = np.diff(times_s)
    steps_s[steps_s < -DAY_S / 2] += DAY_S
    if np.any(steps_s <= 0):
        line = int(np.argmax(steps_s <= 0)) + 3
        raise SourceError(f"{path}, line {line}: its timecode does not come after the line before")
    unrolled = np.concatenate(([0.0], np.cumsum(steps_s)))
    return unrolled, float(np.median(steps_s)) if len(steps_s) else 2 / TIMECODE_FPS
