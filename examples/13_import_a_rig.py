"""Write a toy head with blendshapes as OBJ files, import it, and render a capture of it.

You learn what a rig needs to become an avatar: one topology, a neutral face, and a file per
shape. Names are mapped to ARKit's by rules (`eyeBlink_L` is eyeBlinkLeft); what no rule knows is
listed.
"""

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from pica_core.capture.dataset.sheet import write_sheet
from pica_core.capture.stage.subject import RigSubject
from pica_core.capture.stage.synth import RenderOptions, render_subject

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
OUT.mkdir(parents=True, exist_ok=True)


Tiles = tuple[np.ndarray, np.ndarray, np.ndarray]


def ball(centre_m: Sequence[float], radii_m: Sequence[float], rows: int, columns: int) -> Tiles:
    """Points, texture coordinates and quads of a closed ball, seen from +z."""
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    turn = 2 * np.pi * np.arange(columns + 1) / columns - np.pi
    p, t = np.meshgrid(polar, turn, indexing="ij")
    unit = np.stack([np.sin(p) * np.sin(t), np.cos(p), np.sin(p) * np.cos(t)], -1)
    uv = np.stack([(t + np.pi) / (2 * np.pi), 1 - p / np.pi], -1).reshape(-1, 2) * 0.96 + 0.02
    index = np.arange(rows * (columns + 1)).reshape(rows, columns + 1)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1)
    return (unit * radii_m + centre_m).reshape(-1, 3), uv, quads.reshape(-1, 4)


def write_rig(folder: Path) -> None:
    """A head and two eyeballs; each tile of the texture coordinates belongs to one material."""
    parts = {
        "skin": ball((0, 0, 0), (0.075, 0.12, 0.095), 36, 40),
        "eye_left": ball((0.032, 0.03, 0.078), (0.012,) * 3, 10, 12),
        "eye_right": ball((-0.032, 0.03, 0.078), (0.012,) * 3, 10, 12),
    }
    points = np.concatenate([part[0] for part in parts.values()])
    front = (np.arange(len(points)) < len(parts["skin"][0])) & (points[:, 2] > 0.02)
    tiles = (0, 1, 1)
    uv = np.concatenate(
        [part[1] + [tile, 0] for tile, part in zip(tiles, parts.values(), strict=True)]
    )

    def bump(x_m: float, y_m: float, size_m: float, move_m: tuple[float, ...]) -> np.ndarray:
        distance2 = (points[:, 0] - x_m) ** 2 + (points[:, 1] - y_m) ** 2
        return np.outer(front * np.exp(-distance2 / size_m**2), move_m)

    shapes = {"neutral": 0 * points, "jawOpen": bump(0, -0.07, 0.03, (0, -0.02, 0))}
    for side, x_m in (("L", 0.032), ("R", -0.032)):
        shapes[f"eyeBlink_{side}"] = bump(x_m, 0.036, 0.012, (0, -0.008, 0.001))
        shapes[f"mouthSmile_{side}"] = bump(x_m / 1.3, -0.045, 0.012, (0, 0.006, 0))
    shapes["wiggle"] = bump(0, 0, 0.02, (0, 0.006, 0))  # no ARKit shape: it is left out

    tail = [f"vt {u:.6f} {v:.6f}" for u, v in uv]
    start = 1
    for name, (own, _, quads) in parts.items():
        tail.append(f"usemtl {name}")
        tail += ["f " + " ".join(f"{i}/{i}" for i in quad) for quad in quads + start]
        start += len(own)
    for name, offset in shapes.items():
        lines = [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in points + offset]
        (folder / f"{name}.obj").write_text("\n".join([*lines, *tail]) + "\n")


with tempfile.TemporaryDirectory() as temporary:
    rig, capture = Path(temporary, "rig"), Path(temporary, "capture")
    rig.mkdir()
    write_rig(rig)
    Image.new("RGB", (64, 64), (205, 160, 140)).save(rig / "skin.png")
    subject = RigSubject(rig, None, (f"skin={rig / 'skin.png'}",), bake_size=512, self_shadow=False)
    about = subject.describe()["rig"]
    print(f"mapped: {', '.join(about['mapped'])}")
    print(f"left out: {', '.join(about['ignored'])}; {len(about['missing'])} shapes are missing")
    options = RenderOptions(
        frames=4, cameras=2, size="128x128", texture_size=64, tracked_vertices=600
    )
    counts = render_subject(lambda: subject, options, capture)
    print(f"{counts['images']} images")
    write_sheet(capture, OUT / "rig.png")
