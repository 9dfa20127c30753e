"""What a tracker sends, measured: rate, gaps, missing and constant shapes, with what mends it."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from pica_client.sources.live.sample import TrackerSample
from pica_core.avatar.arkit import ARKIT_NAMES
from pica_core.types import Float64Array

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
class TrackReport:
    """Gathers samples; a `SampleTap`.

    Attributes:
        last: The newest sample; None before the first.
    """

    source: str
    last: TrackerSample | None = None
    _arrived_s: list[float] = field(default_factory=list)
    _process_s: list[float] = field(default_factory=list)
    _samples: list[TrackerSample] = field(default_factory=list)

    def __call__(self, sample: TrackerSample, arrived_s: float, process_s: float) -> None:
        """Take a sample."""
        self.last = sample
        self._samples.append(sample)
        self._arrived_s.append(arrived_s)
        self._process_s.append(process_s)

    @property
    def frames(self) -> int:
        """Samples so far."""
        return len(self._samples)

    def to_json(
        self, trouble: str, refused: Counter[str], subjects: Counter[str]
    ) -> dict[str, Any]:
        """The report; times in milliseconds, angles in degrees.

        Args:
            trouble: Why there is no face, as the source says.
            refused: Datagrams that were not the tracker's, by reason.
            subjects: Samples by subject.
        """
        seen = [sample for sample in self._samples if sample.has_face]
        arkit = np.array([sample.arkit for sample in seen]).reshape(-1, len(ARKIT_NAMES))
        turns = np.degrees([sample.rotation for sample in seen]).reshape(-1, 3)
        span_s = self._arrived_s[-1] - self._arrived_s[0] if self.frames > 1 else 0.0
        gaps_ms = np.diff(self._arrived_s) * 1e3
        report = {
            "source": self.source,
            "frames": self.frames,
            "fps": round((self.frames - 1) / span_s, 2) if span_s else None,
            "gap_ms": _percentiles(gaps_ms, p50=50, p95=95, max=100),
            "jitter_ms": _percentiles(self._jitter_ms(), p50=50, p95=95, max=100),
            "no_face_ratio": round(1 - len(seen) / self.frames, 4) if self.frames else None,
            "shapes": {
                name: _range(arkit[:, index])
                for index, name in enumerate(ARKIT_NAMES)
                if len(arkit) and not np.isnan(arkit[:, index]).all()
            },
            "head": {
                name: _range(turns[:, axis])
                for name, axis in (("yaw", 1), ("pitch", 0), ("roll", 2))
                if len(turns)
            },
            "process_ms": _percentiles(np.array(self._process_s) * 1e3, p50=50, p99=99),
            "refused": dict(refused),
            "subjects": dict(subjects),
        }
        return report | {"hints": _hints(report, trouble, subjects)}

    def _jitter_ms(self) -> Float64Array:
        """How much longer than the shortest way each sample took, by the tracker's clock."""
        pairs = [
            (arrived_s, sample.tracker_s)
            for arrived_s, sample in zip(self._arrived_s, self._samples, strict=True)
            if sample.tracker_s is not None
        ]
        if not pairs:
            return np.empty(0)
        ways = np.subtract(*np.array(pairs).T)
        lateness: Float64Array = (ways - ways.min()) * 1e3
        return lateness


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


def _range(values: Float64Array) -> dict[str, float]:
    """Mean and limits of what was sent."""
    known = values[~np.isnan(values)]
    low = np.quantile(known, 0.05)
    figures = {"mean": known.mean(), "min": known.min(), "max": known.max(), "p05": low}
    return {name: round(float(value), 4) for name, value in figures.items()}


def _percentiles(values: Float64Array, **named: float) -> dict[str, float]:
    if not len(values):
        return {}
    return {name: round(float(np.percentile(values, at)), 3) for name, at in named.items()}
