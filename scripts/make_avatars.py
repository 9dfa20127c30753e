"""Make the avatars that ship: render, train, export, measure and verify each.

    python scripts/make_avatars.py --work work                # an hour each on a core, two for Sam
    python scripts/make_avatars.py --work work --names Sam    # one of them

What is done is left alone and what was stopped goes on, so several processes can share the work.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from claims import give_back, take

FOLDER = Path(__file__).resolve().parent.parent / "pica_core" / "pica_core" / "avatars"
HEADS = {"Sam": "S1", "Ines": "S2", "Olav": "S3", "Mei": "S4", "Karim": "S5"}
"""Name of each avatar, and the built-in head that it is made from."""
TWICE = ("Sam",)
"""Whose training goes on, with twice the expressions."""
STAGE = ("--cameras", "12", "--size", "448x448", "--texture-size", "512")
FRAMES = 384
PRESET = "long"


def main() -> None:
    """Make what is not there yet."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, required=True, help="captures and runs")
    parser.add_argument("--names", nargs="*", default=list(HEADS), choices=list(HEADS))
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    for name in options.names:
        place = options.work / name.lower()
        if (place / "done").exists() or not take(place):
            continue
        make(name, place, options.threads)
        (place / "done").touch()
        give_back(place)


def make(name: str, place: Path, threads: int) -> None:
    """Make one avatar."""
    start = None
    if name in TWICE:
        start = train(HEADS[name], place / "first", FRAMES, threads)
    run = train(HEADS[name], place, FRAMES * (2 if start else 1), threads, start)
    file = FOLDER / f"{name.lower()}.pica"
    words = ["--run", str(run), "--capture", str(place / "capture"), "--out", str(file)]
    pica("export", *words, "--name", name, "--threads", str(threads))
    pica("avatar", "measure", str(file), "--out", str(file))
    pica("avatar", "verify", str(file))


def train(head: str, place: Path, frames: int, threads: int, start: Path | None = None) -> Path:
    """Render a capture and train on it, as far as that is not done. Returns the run."""
    capture, run = place / "capture", place / "run"
    if not (capture / "capture.json").exists():
        words = ["--head", head, "--out", str(capture), "--frames", str(frames)]
        pica("capture", "synth", *words, *STAGE)
    if not (run / "evaluation.json").exists():
        words = ["--capture", str(capture), "--out", str(run), "--preset", PRESET]
        if (run / "checkpoint.pt").exists():
            words.append("--resume")
        elif start is not None:
            words += ["--start-from", str(start)]
        pica("train", *words, "--threads", str(threads))
    return run


def pica(*words: str) -> None:
    """Run a command, and stop where it fails."""
    print("pica", *words, file=sys.stderr)
    subprocess.run([sys.executable, "-m", "pica_command", *words], check=True)


if __name__ == "__main__":
    main()
