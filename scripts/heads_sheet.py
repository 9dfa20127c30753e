"""Check the built-in heads, write the tables of docs/heads.md, and draw docs/heads.png.

python scripts/heads_sheet.py [--combinations 1000] [--worst FILE.png]

Tables stand between markers in docs/heads.md. The picture shows every head from the front, from
the side, smiling and astonished; `--worst` draws the combination with the least room between an
eyeball or a tooth and the skin over it.
"""

from __future__ import annotations

import argparse
import io
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
from charting import fill_in
from PIL import Image

from pica_core.avatar.arkit import ARKIT_NAMES, NUM_ARKIT
from pica_core.camera import Camera, look_at
from pica_core.capture.procedural.heads import HEADS, make_head
from pica_core.capture.procedural.subject import ProceduralSubject
from pica_core.capture.stage.expressions import blend, sample_takes

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from helpers.head_checks import HeadChecks, HeadFaults  # noqa: E402
from helpers.head_zones import all_motions, zones_of  # noqa: E402

DOCS = ROOT / "docs"
TILE_PX = 224
SEED = 7
GRIN = blend(jawOpen=0.12, mouthSmile=0.9, mouthUpperUp=0.45, mouthLowerDown=0.4, cheekSquint=0.6)
WIDE = blend(eyeWide=1.0, browInnerUp=1.0, browOuterUp=1.0, jawOpen=0.4)
VIEWS = ((0.0, blend()), (38.0, blend()), (88.0, blend()), (15.0, GRIN), (-20.0, WIDE))


def camera(azimuth: float, size: int, reach_m: float = 0.32) -> Camera:
    """A camera a metre away; `azimuth` in degrees towards the subject's left."""
    a = np.radians(azimuth)
    target = np.array([0.0, -0.008, 0.02])
    away = np.array([np.sin(a), 0.05, np.cos(a)])
    return look_at(
        name="sheet",
        centre_m=target + away,
        target_m=target,
        vertical_fov=2 * np.arctan(0.5 * reach_m),
        width=size,
        height=size,
    )


def draw_sheet() -> bytes:
    """One row per head; PNG with at most 256 colours."""
    rows = []
    for name in HEADS:
        subject = ProceduralSubject(name)
        tiles = []
        for azimuth, arkit in VIEWS:
            subject.pose(arkit)
            tiles.append(subject.draw(camera(azimuth, TILE_PX)).image)
        subject.release()
        rows.append(np.concatenate(tiles, 1))
    half = (len(rows) + 1) // 2
    page = np.concatenate([np.concatenate(rows[:half]), np.concatenate(rows[half:])], 1)
    out = io.BytesIO()
    Image.fromarray(page).quantize(256).save(out, "PNG", optimize=True)
    return out.getvalue()


def motion_table() -> list[str]:
    """Worst of all heads per shape, left standing for right."""
    motions = [all_motions(make_head(name)) for name in HEADS]
    lines = ["| shape | zones | moves at least, mm | in its zones | on its side | elsewhere, mm |"]
    lines.append("|---|---|---|---|---|---|")
    for index, shape in enumerate(ARKIT_NAMES):
        if shape.endswith("Right"):
            continue
        of = [motion[index] for motion in motions]
        lines.append(
            f"| {shape} | {', '.join(zones_of(shape))} | {min(m.peak_mm for m in of):.1f} "
            f"| {min(m.share for m in of):.3f} | {min(m.side_share for m in of):.3f} "
            f"| {max(m.elsewhere_mm for m in of):.1f} |"
        )
    return lines


def count_faults(combinations: int, worst: Path | None) -> list[str]:
    """Single shapes at 1, and combinations from performances dealt out to the heads in turn."""
    arkit = np.concatenate([take.arkit for take in sample_takes(combinations, SEED)])
    singles = np.eye(NUM_ARKIT)
    lines = ["| head | full shapes | faults | combinations | faults | least room, mm |"]
    lines.append("|---|---|---|---|---|---|")
    closest: tuple[float, str, npt.NDArray[np.float32]] | None = None
    for index, name in enumerate(HEADS):
        checks = HeadChecks(make_head(name))
        part = arkit[index :: len(HEADS)]
        alone = [checks.faults(values) for values in singles]
        mixed = [checks.faults(values) for values in part]
        room = [fault.clearance_mm for fault in mixed]
        lines.append(
            f"| {name} | {len(alone)} | {_sum(alone)} | {len(mixed)} | {_sum(mixed)} "
            f"| {min(room):.2f} |"
        )
        if closest is None or min(room) < closest[0]:
            closest = (min(room), name, part[int(np.argmin(room))])
    if worst is not None and closest is not None:
        subject = ProceduralSubject(closest[1])
        subject.pose(closest[2])
        tiles = [subject.draw(camera(azimuth, 640, 0.2)).image for azimuth in (0.0, 30.0)]
        subject.release()
        Image.fromarray(np.concatenate(tiles, 1)).save(worst)
    return lines


def _sum(faults: list[HeadFaults]) -> int:
    return sum(fault.total for fault in faults)


def main() -> None:
    """Check, write, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--combinations", type=int, default=1000)
    parser.add_argument("--worst", type=Path)
    options = parser.parse_args()
    page = DOCS / "heads.md"
    fill_in(page, "motion", "\n".join(motion_table()))
    fill_in(page, "faults", "\n".join(count_faults(options.combinations, options.worst)))
    (DOCS / "heads.png").write_bytes(draw_sheet())


if __name__ == "__main__":
    main()
