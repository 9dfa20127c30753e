"""A tiny head with blendshapes, and writers of the files that rigs come in."""

import json
import struct
from collections.abc import Container
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pica_core.types import Array

COMPONENT = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KIND = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
EYES = {"eye_left": (0.032, 0.03, 0.078), "eye_right": (-0.032, 0.03, 0.078)}


@dataclass
class ToyRig:
    """Positions in metres, +y up, +z out of the face; quads by material; uv with v upwards."""

    positions: Array
    uv: Array
    quads: dict[str, Array]
    shapes: dict[str, Array] = field(default_factory=dict)


def _ball(
    centre: tuple[float, float, float], radii: tuple[float, float, float], rows: int, columns: int
) -> tuple[Array, Array, Array]:
    """A closed ball around the y axis: points, uv, quads (counter-clockwise from outside)."""
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    turn = 2 * np.pi * np.arange(columns + 1) / columns - np.pi
    p, t = np.meshgrid(polar, turn, indexing="ij")
    unit = np.stack([np.sin(p) * np.sin(t), np.cos(p), np.sin(p) * np.cos(t)], -1)
    points = unit * radii + centre
    uv = np.stack([(t + np.pi) / (2 * np.pi), 1 - p / np.pi], -1) * 0.96 + 0.02
    index = np.arange(rows * (columns + 1)).reshape(rows, columns + 1)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1)
    return points.reshape(-1, 3), uv.reshape(-1, 2), quads.reshape(-1, 4)


def toy_rig() -> ToyRig:
    """A head with two eyeballs and a tooth; jawOpen, blinks, smiles, a split brow, an unknown."""
    points, uv, quads = _ball((0.0, 0.0, 0.0), (0.075, 0.12, 0.095), 36, 40)
    parts = {"skin": quads}
    skin_count = len(points)
    all_points, all_uv = [points], [uv]
    for name, centre in EYES.items():
        ball, ball_uv, ball_quads = _ball(centre, (0.012, 0.012, 0.012), 10, 12)
        parts[name] = ball_quads + sum(map(len, all_points))
        all_points.append(ball)
        all_uv.append(ball_uv + np.array([1, 0]))  # both eyes on the same place of the second tile
    tooth, tooth_uv, tooth_quads = _ball((0.0, -0.05, 0.07), (0.005, 0.006, 0.004), 6, 8)
    parts["Teeth"] = tooth_quads + sum(map(len, all_points))
    all_points.append(tooth)
    all_uv.append(tooth_uv + np.array([2, 0]))
    rig = ToyRig(np.concatenate(all_points), np.concatenate(all_uv), parts)
    p = rig.positions
    skin = np.arange(len(p)) < skin_count
    front = skin & (p[:, 2] > 0.02)

    def bump(x: float, y: float, size: float) -> Array:
        return np.where(front, np.exp(-((p[:, 0] - x) ** 2 + (p[:, 1] - y) ** 2) / size**2), 0.0)

    jaw = np.where(front & (p[:, 1] < -0.045) & (np.abs(p[:, 0]) < 0.04), 0.02, 0.0)
    rig.shapes["jawOpen"] = np.stack([0 * jaw, -jaw, 0 * jaw], 1)
    down, up = np.array([0.0, -0.008, 0.001]), np.array([0.0, 0.006, 0.0])
    for side, x in (("L", 0.032), ("R", -0.032)):
        rig.shapes[f"eyeBlink_{side}"] = bump(x, 0.036, 0.012)[:, None] * down
        rig.shapes[f"browInnerUp_{side}"] = bump(x / 2, 0.05, 0.012)[:, None] * up
        rig.shapes[f"mouthSmile_{side}"] = bump(x / 1.3, -0.045, 0.012)[:, None] * up
    rig.shapes["somethingElse"] = bump(0.0, 0.0, 0.02)[:, None] * up
    return rig


def glb_bytes(document: dict[str, Any], binary: bytes) -> bytes:
    """The container of a .glb file."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    size = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<III", 0x46546C67, 2, size)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    return head + chunks + struct.pack("<II", len(binary), 0x004E4942) + binary


def document_of(rig: ToyRig, image: bytes | None = None) -> tuple[dict[str, Any], list[Array]]:
    """A glTF document and the arrays of its accessors; z up, turned upright by its node."""
    arrays: list[Array] = []

    def add(data: Array) -> int:
        arrays.append(data)
        return len(arrays) - 1

    def turned(points: Array) -> Array:  # our (x, y, z) as the file's (x, -z, y)
        return np.stack([points[:, 0], -points[:, 2], points[:, 1]], 1).astype("<f4")

    position = add(turned(rig.positions))
    texture = add(np.stack([rig.uv[:, 0], 1 - rig.uv[:, 1]], 1).astype("<f4"))  # v goes down
    targets = [{"POSITION": add(turned(delta))} for delta in rig.shapes.values()]
    primitives = []
    for number, quads in enumerate(rig.quads.values()):
        triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype("<u2")
        primitives.append(
            {
                "attributes": {"POSITION": position, "TEXCOORD_0": texture},
                "indices": add(triangles.reshape(-1, 1)),
                "material": number,
                "targets": targets,
            }
        )
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "copyright": "nobody"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": [-(0.5**0.5), 0, 0, 0.5**0.5]}],
        "meshes": [{"primitives": primitives, "extras": {"targetNames": list(rig.shapes)}}],
        "materials": [{"name": name} for name in rig.quads],
    }
    if image is not None:
        document["textures"] = [{"source": 0}]
        document["materials"][0]["pbrMetallicRoughness"] = {"baseColorTexture": {"index": 0}}
    return document, arrays


def packed(
    document: dict[str, Any],
    arrays: list[Array],
    image: bytes | None = None,
    *,
    normalized: Container[int] = (),
    sparse: Container[int] = (),
) -> tuple[dict[str, Any], bytes]:
    """A document with accessors of its arrays, and its one buffer."""
    binary = b""
    views: list[dict[str, Any]] = []

    def view(data: bytes) -> int:
        nonlocal binary
        binary += b"\0" * (-len(binary) % 4)
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        binary += data
        return len(views) - 1

    accessors = []
    for number, values in enumerate(arrays):
        entry: dict[str, Any] = {
            "componentType": COMPONENT[values.dtype.str[1:]], "count": len(values),
            "type": KIND[values.shape[1]], "normalized": number in normalized,
        }  # fmt: skip
        if number in sparse:
            moved = np.flatnonzero(np.abs(values).max(1) > 0)
            indices = {"bufferView": view(moved.astype("<u2").tobytes()), "componentType": 5123}
            where = {"bufferView": view(values[moved].tobytes())}
            entry["sparse"] = {"count": len(moved), "indices": indices, "values": where}
        else:
            entry["bufferView"] = view(values.tobytes())
        accessors.append(entry)
    document = {**document, "accessors": accessors, "bufferViews": views}
    if image is not None:
        document["images"] = [{"bufferView": view(image), "mimeType": "image/png"}]
    document["buffers"] = [{"byteLength": len(binary)}]
    return document, binary


def glb_parts(rig: ToyRig, *, image: bytes | None = None) -> tuple[dict[str, Any], bytes]:
    """JSON document and binary chunk of a rig."""
    return packed(*document_of(rig, image), image)


def write_glb(path: Path, rig: ToyRig, *, image: bytes | None = None) -> Path:
    """The rig as one .glb file."""
    path.write_bytes(glb_bytes(*glb_parts(rig, image=image)))
    return path
