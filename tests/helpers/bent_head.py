"""A built-in head that bases do not suffice for: furrows that travel, skin that slides, hair that
swings.

    python tests/helpers/bent_head.py OUT [FRAMES CAMERAS SIDE]

Everything is a curved function of the 52 values. A furrow that is drawn across the skin is at every
place another shape, so that no small number of shapes adds up to it; the jaw and the eyes of the
built-in heads turn, too, which a few more shapes do make up for.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.capture.procedural.heads import ProceduralHead
from pica_core.capture.procedural.subject import ProceduralSubject
from pica_core.capture.stage.synth import RenderOptions, render_subject
from pica_core.types import FloatArray

FURROW_MM, WIDTH_MM, WAY_MM = 2.5, 2.0, 34.0
"""Depth and half width of a furrow, and how far it is drawn."""


class BentHead(ProceduralHead):
    """A built-in head with furrows, sliding skin and swinging hair."""

    def vertices_batch(self, arkit: npt.ArrayLike) -> FloatArray:
        """Pose the plain head, then bend it; the neutral face is the plain one's."""
        plain = super().vertices_batch(arkit)
        values = np.asarray(arkit, np.float32)
        if not values.any():  # the plain head looks at its neutral face while it is made
            return plain
        moved = [self._bend(1e3 * points, one) for points, one in zip(plain, values, strict=True)]
        return (1e-3 * np.stack(moved)).astype(np.float32)

    def _bend(self, points: FloatArray, values: FloatArray) -> FloatArray:
        def of(name: str) -> float:
            return float(values[ARKIT_INDEX[name]])

        mark, skin, hair = self.landmarks, self.charts["skin"], self.charts["hair"]
        x, y, z = self._rest[skin].astype(np.float32).T
        front = np.clip(z / 40, 0, 1)
        bent, on_skin = points.copy(), points[skin].copy()
        raised = max(of("browInnerUp"), 0.5 * (of("browOuterUpLeft") + of("browOuterUpRight")))
        for start in (8.0, 16.0):
            height = y - (mark["brow_y"] + start + WAY_MM * raised)
            on_skin[:, 2] += raised * front * _furrow(height) * np.exp(-((x / 35) ** 2))
        for side, name in ((1.0, "Left"), (-1.0, "Right")):
            smile = of(f"mouthSmile{name}")
            beside = side * x - (mark["mouth_half"] + 2 + WAY_MM * smile)
            on_cheek = np.exp(-(((y - mark["mouth_y"] - 8) / 16) ** 2)) * front
            on_skin[:, 2] += 1.5 * smile * on_cheek * _furrow(beside)
        jaw = of("jawOpen")
        below = y - (mark["chin_y"] + 12 - WAY_MM * jaw)
        slides = np.exp(-((below / 7) ** 2)) * front
        on_skin[:, 0] += 4 * jaw * slides * np.sin(x / 6)
        on_skin[:, 2] += 1.5 * jaw * slides * np.cos(x / 4)
        bent[skin] = on_skin
        strand = self._rest[hair].astype(np.float32)
        depth = np.clip((strand[:, 1].max() - strand[:, 1]) / 120, 0, 1) ** 2
        phase = strand[:, 1] / 18 + 5 * (of("mouthLeft") - of("mouthRight") + jaw)
        bent[hair, 0] += 3 * depth * (np.sin(phase) - np.sin(strand[:, 1] / 18))
        return bent


def _furrow(distance_mm: FloatArray) -> FloatArray:
    """Depth at a distance from a furrow's middle: a valley between two ridges."""
    along = distance_mm / WIDTH_MM
    profile: FloatArray = -FURROW_MM * (1 - along**2) * np.exp(-(along**2) / 2)
    return profile


class BentSubject(ProceduralSubject):
    """S1, bent, on the stage."""

    def __init__(self, *, bake_size: int = 512) -> None:
        super().__init__(BentHead("S1"), bake_size=bake_size, self_shadow=False)
        self.name = "bent S1"


def render_bent(out: Path, frames: int = 160, cameras: int = 6, side: int = 256) -> None:
    """Render a capture of the bent head."""
    stage = RenderOptions(frames=frames, cameras=cameras, width=side, height=side)
    render_subject(lambda: BentSubject(bake_size=min(4 * side, 1024)), stage, out)


if __name__ == "__main__":
    render_bent(Path(sys.argv[1]), *map(int, sys.argv[2:]))
