"""Write a toy head with blendshapes as a glTF file, import it, and render a capture of it.

You learn what a rig needs to become an avatar: a mesh and named morph targets. Names are mapped to
ARKit's by rules (`eyeBlink_L` is eyeBlinkLeft); what no rule knows is listed.
"""

import base64
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.stage.subject import RigSubject
from pica_core.capture.stage.synth import RenderOptions, render_subject

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
OUT.mkdir(parents=True, exist_ok=True)

Tiles = tuple[np.ndarray, np.ndarray, np.ndarray]


def ball(centre_m: tuple[float, ...], radii_m: tuple[float, ...], rows: int, columns: int) -> Tiles:
    """Points, texture coordinates and quads of a closed ball, seen from +z."""
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    turn = 2 * np.pi * np.arange(columns + 1) / columns - np.pi
    p, t = np.meshgrid(polar, turn, indexing="ij")
    unit = np.stack([np.sin(p) * np.sin(t), np.cos(p), np.sin(p) * np.cos(t)], -1)
    uv = np.stack([(t + np.pi) / (2 * np.pi), 1 - p / np.pi], -1).reshape(-1, 2) * 0.96 + 0.02
    index = np.arange(rows * (columns + 1)).reshape(rows, columns + 1)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1)
    return (unit * radii_m + centre_m).reshape(-1, 3), uv, quads.reshape(-1, 4)


def write_rig(path: Path) -> None:
    """A head and two eyeballs."""
    eyes = [ball((x, 0.03, 0.078), (0.012,) * 3, 10, 12) for x in (0.032, -0.032)]
    parts = [ball((0, 0, 0), (0.075, 0.12, 0.095), 36, 40), *eyes]
    points, uv = (np.concatenate([part[k] for part in parts]) for k in range(2))
    front = (np.arange(len(points)) < len(parts[0][0])) & (points[:, 2] > 0.02)

    def bump(x_m: float, y_m: float, size_m: float, move_m: tuple[float, ...]) -> np.ndarray:
        distance2 = (points[:, 0] - x_m) ** 2 + (points[:, 1] - y_m) ** 2
        return np.outer(front * np.exp(-distance2 / size_m**2), move_m)

    shapes = {"jawOpen": bump(0, -0.07, 0.03, (0, -0.02, 0))}
    for side, x_m in (("L", 0.032), ("R", -0.032)):
        shapes[f"eyeBlink_{side}"] = bump(x_m, 0.036, 0.012, (0, -0.008, 0.001))
        shapes[f"mouthSmile_{side}"] = bump(x_m / 1.3, -0.045, 0.012, (0, 0.006, 0))
    shapes["wiggle"] = bump(0, 0, 0.02, (0, 0.006, 0))  # no ARKit shape: it is left out

    binary, views, accessors = b"", [], []

    def add(values: np.ndarray, kind: str, component: int) -> int:
        nonlocal binary
        data = values.astype("<f4" if component == 5126 else "<u4").tobytes()
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        entry = {"bufferView": len(views) - 1, "componentType": component, "type": kind}
        accessors.append({**entry, "count": len(values)})
        binary += data
        return len(accessors) - 1

    position = add(points, "VEC3", 5126)
    texture = add(uv, "VEC2", 5126)
    targets = [{"POSITION": add(offset, "VEC3", 5126)} for offset in shapes.values()]
    primitives, start = [], 0
    for number, (own, _, quads) in enumerate(parts):
        triangles = start + np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        attributes = {"POSITION": position, "TEXCOORD_0": texture}
        indices = add(triangles.reshape(-1, 1), "SCALAR", 5125)
        material = {"indices": indices, "material": min(number, 1)}
        primitives.append({"attributes": attributes, "targets": targets, **material})
        start += len(own)
    buffer = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    document = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": primitives, "extras": {"targetNames": list(shapes)}}],
        "materials": [{"name": "skin"}, {"name": "eyes"}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary), "uri": buffer}],
    }
    path.write_text(json.dumps(document))


with tempfile.TemporaryDirectory() as temporary:
    rig, folder = Path(temporary, "toy.gltf"), Path(temporary, "capture")
    write_rig(rig)
    subject = RigSubject(rig, bake_size=512, self_shadow=False)
    about = subject.about["rig"]
    print(f"mapped: {', '.join(about['mapped'])}")
    print(f"left out: {', '.join(about['ignored'])}; {len(about['missing'])} shapes are missing")
    options = RenderOptions(frames=4, cameras=2, size="128x128", texture_size=64)
    render_subject(lambda: subject, options, folder)
    capture = Capture.open(folder)
    Image.fromarray(capture.image(capture.frames[-1], "front")).save(OUT / "rig.png")
