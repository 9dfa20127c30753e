"""A user's own take, for a capture that shall know their face: which of its moments to render."""

import csv
import io
import zipfile
from pathlib import Path

import numpy as np

from pica_core.avatar.arkit import ARKIT_NAMES, NUM_ARKIT
from pica_core.capture.dataset.files import Take, read_bytes
from pica_core.capture.stage.expressions import HISTORY
from pica_core.errors import CaptureError
from pica_core.types import Array, FloatArray

MAX_ROWS = 1_000_000
HIGHEST = 1.05
"""Largest value in seven real recordings; more is cut off."""


def read_own_take(path: Path) -> FloatArray:
    """Read the 52 values of a recording: a CSV of Live Link Face, or what `pica track` records.

    Moments without a face, and those with a value that is no number, are left out. ``[T, 52]``.

    Raises:
        CaptureError: Neither of the two, names of another tracker, or no face in it.
    """
    data = read_bytes(path)
    values = _archive(path, data) if data[:2] == b"PK" else _table(path, data)
    values = values[np.isfinite(values).all(1)]
    if not len(values):
        raise CaptureError(f"{path}: no moment with a face and numbers alone")
    return np.clip(values, 0.0, HIGHEST).astype(np.float32)


def _archive(path: Path, data: bytes) -> Array:
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            values, seen = archive["arkit"], archive["has_face"]
    except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise CaptureError(f"{path}: is no take; `pica track SOURCE --record` makes one") from error
    if values.shape != (len(seen), NUM_ARKIT) or seen.dtype != np.bool_ or len(seen) > MAX_ROWS:
        raise CaptureError(f"{path}: arkit is {values.dtype} {values.shape}; the file is no take")
    return np.asarray(values[seen], np.float64)


def _table(path: Path, data: bytes) -> Array:
    try:
        rows = list(csv.reader(io.StringIO(data.decode("utf-8-sig"))))
    except (UnicodeDecodeError, csv.Error) as error:
        raise CaptureError(f"{path}: neither a CSV file nor a take ({error})") from error
    at = {name.strip().lower(): column for column, name in enumerate(rows[0] if rows else [])}
    missing = [name for name in ARKIT_NAMES if name.lower() not in at]
    if missing:
        raise CaptureError(
            f"{path}: lacks {len(missing)} of {NUM_ARKIT} columns ({', '.join(missing[:3])}, ...); "
            "a Live Link Face CSV in ARKit mode, or a take of `pica track`, is needed"
        )
    columns = [at[name.lower()] for name in ARKIT_NAMES]
    count = at.get("blendshapecount")
    values = []
    for line, row in enumerate(rows[1 : MAX_ROWS + 1], start=2):
        if len(row) != len(rows[0]):
            if not row:
                continue
            raise CaptureError(f"{path}, line {line}: {len(row)} of {len(rows[0])} values")
        if count is None or row[count].strip() != "0":
            try:
                values.append([float(row[column]) for column in columns])
            except ValueError as error:
                raise CaptureError(f"{path}, line {line}: {error}") from error
    return np.array(values).reshape(-1, NUM_ARKIT)


def own_take(values: FloatArray, count: int) -> Take:
    """Plan a training take of the `count` moments that lie farthest from each other.

    Each next one is the moment farthest from all before it (k-centre), the first the farthest from
    the neutral face; so extremes and odd combinations come first. A shorter take repeats.
    """
    distance = np.linalg.norm(values, axis=1)
    chosen: list[int] = []
    for _ in range(count):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(values - values[chosen[-1]], axis=1))
    moments = np.sort(chosen)
    before = np.maximum(moments[:, None] - np.arange(1, HISTORY + 1), 0)
    return Take(segment="OWN000", arkit=values[moments], history=values[before], split="train")
