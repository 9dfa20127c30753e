"""Held-out errors as `pica eval` printed them, found again by identity, variant and block.

What it takes is what ``pica eval --json`` prints, its ``eval.json``, or recorded lines
(docs/results). The interval of a model's error over several views is the mean of the views' own: no
narrower than the true one, and hardly wider, for the views show the same frames.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from pica_client.errors import OptionError

MAX_FILE_BYTES = 64 * 2**20
_NUMBERS = ("mse", "mse_low", "mse_high", "psnr_db", "ssim", "parameters", "steps", "seed")
_NAMES = ("identity", "variant", "view")

Row = Mapping[str, Any]


class ModelKey(NamedTuple):
    """Which model of whom.

    Attributes:
        identity: Who was captured.
        variant: Row of the paper's tables.
        block: Of the per-object decoders; None where there are none.
    """

    identity: str
    variant: str
    block: str | None

    def __str__(self) -> str:
        block = "" if self.block is None else f" with block {self.block}"
        return f"{self.identity} {self.variant}{block}"


@dataclass(frozen=True, kw_only=True, slots=True)
class HeldOutError:
    """What a model leaves on held-out frames: means over views."""

    mse: float
    """0-255, over rasterised pixels."""
    mse_low: float
    mse_high: float
    psnr_db: float
    ssim: float
    views: int
    """Number of views."""
    frames: int | None
    """Test frames; None where the rows do not say."""
    parameters: int
    """Parameters of the model that was measured."""
    steps: int
    seed: int


class EvalRows:
    """Rows of any number of evaluations.

    Args:
        rows: One for each model and view; of two about the same one the later counts.
    """

    def __init__(self, rows: Iterable[Row]) -> None:
        self._views: dict[ModelKey, dict[int, dict[str, Row]]] = {}
        for row in rows:
            key = ModelKey(row["identity"], row["variant"], row["block"])
            self._views.setdefault(key, {}).setdefault(row["seed"], {})[row["view"]] = row

    @classmethod
    def read(cls, paths: Sequence[Path]) -> EvalRows:
        """Read files.

        Raises:
            OptionError: One cannot be read, or has something else in it; names file and field.
        """
        return cls(row for path in paths for row in _rows_of(path))

    def error_of(self, key: ModelKey) -> HeldOutError:
        """The error of a model.

        Raises:
            OptionError: No rows, or rows of several runs.
        """
        runs = self._views.get(key)
        if not runs:
            known = ", ".join(sorted(map(str, self._views))) or "none"
            raise OptionError(f"rows: no error of {key}; there are {known}")
        if len(runs) > 1:
            seeds = ", ".join(map(str, sorted(runs)))
            raise OptionError(f"rows: {key} was trained with seeds {seeds}; leave the rows of one")
        ((_, by_view),) = runs.items()
        rows = list(by_view.values())
        frames = {row.get("frames") for row in rows}
        means = {
            name: math.fsum(row[name] for row in rows) / len(rows)
            for name in ("mse", "mse_low", "mse_high", "psnr_db", "ssim")
        }
        return HeldOutError(
            **means,
            views=len(rows),
            frames=frames.pop() if len(frames) == 1 else None,
            parameters=int(rows[0]["parameters"]),
            steps=int(rows[0]["steps"]),
            seed=int(rows[0]["seed"]),
        )


def _rows_of(path: Path) -> Iterator[Row]:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise OptionError(f"{path}: cannot be read: {error.strerror or error}") from error
    if len(data) > MAX_FILE_BYTES:
        raise OptionError(f"{path}: larger than {MAX_FILE_BYTES} bytes, the limit")
    for value in _values(path, data):
        result = value.get("result", value) if isinstance(value, dict) else value
        rows = result.get("rows") if isinstance(result, dict) else None
        if not isinstance(rows, list):
            raise OptionError(f"{path}: field rows is missing; `pica eval --json` writes it")
        for row in rows:
            _check(path, row)
            yield row


def _values(path: Path, data: bytes) -> list[Any]:
    """The file as one JSON value, or its lines that hold one: tables may be printed above."""
    try:
        return [json.loads(data)]
    except ValueError:
        lines = [line for line in data.splitlines() if line.startswith(b"{")]
    try:
        found = [json.loads(line) for line in lines]
    except ValueError as error:
        raise OptionError(f"{path}: neither JSON nor lines of it ({error})") from error
    if not found:
        raise OptionError(f"{path}: no JSON in it; `pica eval --json` prints some")
    return found


def _check(path: Path, row: Any) -> None:
    if not isinstance(row, dict):
        raise OptionError(f"{path}: rows has {row!r:.40}; a map is needed")
    if "block" not in row and set(_NAMES + _NUMBERS) <= set(row):
        raise OptionError(f"{path}: rows.block is missing; measure again with `pica eval`")

    def require(name: str, is_right: bool, wanted: str) -> None:
        if not is_right:
            raise OptionError(f"{path}: rows.{name} is {row.get(name)!r:.40}; {wanted} is needed")

    for name in _NAMES:
        require(name, isinstance(row.get(name), str), "a text")
    for name in _NUMBERS:
        value = row.get(name)
        require(
            name,
            isinstance(value, int | float) and type(value) is not bool and math.isfinite(value),
            "a number",
        )
    require("block", isinstance(row.get("block"), str | None), "a text or null")
