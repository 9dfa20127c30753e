"""Checkpoint files: written aside, brought to the disk, then renamed; read without running code."""

import os
from pathlib import Path
from typing import Any

import torch

from pica_core.errors import CheckpointError

CHECKPOINT_VERSION = 2
NAME = "checkpoint.pt"


def write_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint; whatever happens, the file of before or the new one is there, whole.

    Raises:
        CheckpointError: It cannot be written, for example because the disk is full.
    """
    aside = path.with_suffix(".part")
    try:
        with aside.open("wb") as file:
            torch.save({"version": CHECKPOINT_VERSION, **state}, file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(aside, path)
        _sync_folder(path.parent)
    except (OSError, RuntimeError) as error:  # torch's writer turns an OSError into RuntimeError
        aside.unlink(missing_ok=True)
        kept = "the one before is whole" if path.exists() else "there is none yet"
        reason = error.__context__ if isinstance(error.__context__, OSError) else error
        raise CheckpointError(f"{path}: checkpoint cannot be written ({reason}); {kept}") from error


def _sync_folder(folder: Path) -> None:
    """Make a rename survive a loss of power, where folders can be opened at all."""
    if os.name == "posix":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint's state; tensors and plain values only, no code.

    Raises:
        CheckpointError: Missing, damaged or of another version.
    """
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: no checkpoint there") from error
    except Exception as error:  # torch.load raises many types for a damaged file
        raise CheckpointError(f"{path}: not a readable checkpoint ({error})") from error
    if not isinstance(state, dict) or state.get("version") != CHECKPOINT_VERSION:
        raise CheckpointError(f"{path}: checkpoint version is not {CHECKPOINT_VERSION}")
    return state
