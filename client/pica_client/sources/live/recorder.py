"""What a tracker sends: kept as a recording, and reported on with what would mend it.

A recording is a CSV file as Live Link Face saves it, at the times at which samples arrived: the
source ``csv:FILE`` plays it, and other programs read it. Where the head is does not fit into it.
"""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from pica_client.errors import SourceError
from pica_client.sources.live.live_face import TrackerSample
from pica_client.sources.rotation import yaw_pitch_roll_from_rotation_vector
from pica_core.avatar.arkit import ARKIT_NAMES, NUM_ARKIT
from pica_core.files import replacing
from pica_core.livelink import MAX_ROWS, livelink_csv
from pica_core.types import FloatArray

LOW_FPS: Final = 20.0
LONG_GAP_MS: Final = 150.0
CONSTANT: Final = 1e-4
"""A shape that moves by less than this in all the time never moves."""
SHIFTED_AT_REST: Final = 0.15
"""Fifth percentile of a shape above this: the face at rest is not at rest."""
MANY_CONSTANT: Final = 5
NAMED_SHAPES: Final = 6
"""Names in a hint before it says how many more."""


@dataclass(slots=True)
class Recorder:
    """Gathers what a tracker sends, to keep it and to report on it; a `SampleTap`."""

    samples: list[tuple[float, TrackerSample]] = field(default_factory=list)
    """When each arrived, and what it was."""

    def __call__(self, sample: TrackerSample, arrived_s: float) -> None:
        """Keep a sample."""
        if len(self.samples) < MAX_ROWS:
            self.samples.append((arrived_s, sample))

    def save(self, path: Path) -> None:
        """Write the recording; shapes that the tracker does not send are 0.

        Raises:
            SourceError: Nothing was recorded, or the file cannot be written.
        """
        if not self.samples:
            raise SourceError(f"{path}: not written, because nothing was recorded")
        rows = [
            (
                arrived_s - self.samples[0][0],
                [*np.nan_to_num(each.arkit), *yaw_pitch_roll_from_rotation_vector(each.rotation)]
                if each.has_face
                else None,
            )
            for arrived_s, each in self.samples
        ]
        try:
            with replacing(path) as unfinished:
                unfinished.write_text(livelink_csv(rows), encoding="utf-8")
        except OSError as error:
            raise SourceError(f"{path}: cannot be written: {error.strerror}") from error

    def report(self, trouble: str, refused: Counter[str], subjects: Counter[str]) -> dict[str, Any]:
        """What came, and what would mend it; times in milliseconds, angles in degrees.

        Args:
            trouble: Why there is no face, as the source says.
            refused: Datagrams that were not the tracker's, by reason.
            subjects: Samples by subject.
        """
        gaps_ms = 1000 * np.diff([arrived_s for arrived_s, _ in self.samples])
        seen = [sample for _, sample in self.samples if sample.has_face]
        arkit = np.array([sample.arkit for sample in seen]).reshape(-1, NUM_ARKIT)
        turns = np.degrees([sample.rotation for sample in seen]).reshape(-1, 3)
        count = len(self.samples)
        report = {
            "frames": count,
            "fps": round(1000 / float(gaps_ms.mean()), 2) if gaps_ms.any() else None,
            "gap_ms": _figures(gaps_ms, p50=50, p95=95, max=100),
            "no_face_ratio": round(1 - len(seen) / count, 4) if count else None,
            "shapes": {
                name: _figures(values, min=0, p05=5, max=100)
                for name, values in zip(ARKIT_NAMES, arkit.T, strict=True)
                if not np.isnan(values).all()
            },
            "head": {
                name: _figures(turns[:, axis], min=0, max=100)
                for name, axis in (("yaw", 1), ("pitch", 0), ("roll", 2))
                if len(turns)
            },
            "refused": dict(refused),
            "subjects": dict(subjects),
        }
        return report | {"hints": _hints(report, trouble, subjects)}


def _hints(report: dict[str, Any], trouble: str, subjects: Counter[str]) -> list[str]:
    """What is wrong with a report, each with what mends it."""
    if not report["frames"]:
        return [trouble] if trouble else ["nothing came; run it longer"]
    hints = [trouble] if trouble else []
    shapes = report["shapes"]
    if report["no_face_ratio"] > 0.1:
        hints.append("the tracker often sees no face: more light, and look at its camera")
    if report["fps"] is not None and report["fps"] < LOW_FPS:
        hints.append(
            f"only {report['fps']:g} samples a second: a cooler phone, or less load, helps"
        )
    if report["gap_ms"].get("max", 0) > LONG_GAP_MS:
        hints.append("gaps above 150 ms: use a cable or 5 GHz Wi-Fi, near to the access point")
    if missing := [name for name in ARKIT_NAMES if name not in shapes]:
        hints.append(f"not sent: {_named(missing)}; they stay at rest")
    constant = [name for name, each in shapes.items() if each["max"] - each["min"] < CONSTANT]
    if len(constant) >= MANY_CONSTANT:
        hints.append(f"never move: {_named(constant)}; make faces while this runs")
    head = report["head"]
    if head and all(each["max"] - each["min"] < CONSTANT for each in head.values()):
        hints.append('the head never turns: switch on "Stream Head Rotation", or the like')
    shifted = [name for name, each in shapes.items() if each["p05"] > SHIFTED_AT_REST]
    if any(not name.startswith(("eyeBlink", "eyeLook")) for name in shifted):
        hints.append(f"never at rest: {_named(shifted)}; `pica calibrate` takes that away")
    if len(subjects) > 1:
        hints.append(f"several faces on this port: {', '.join(subjects)}; name one: livelink/NAME")
    return hints


def _named(shapes: list[str]) -> str:
    """The first of many names, and how many more there are."""
    more = len(shapes) - NAMED_SHAPES
    return ", ".join(shapes[:NAMED_SHAPES]) + (f" and {more} more" if more > 0 else "")


def _figures(values: FloatArray, **percentiles: float) -> dict[str, float]:
    """Percentiles of the values that are numbers, by name; nothing where there are none."""
    known = values[~np.isnan(values)]
    named = percentiles if len(known) else {}
    return {name: round(float(np.percentile(known, at)), 4) for name, at in named.items()}
