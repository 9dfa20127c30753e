"""Golden vectors of the latent bitstream: tables, faces, payloads and what they decode to.

``python tests/golden/stream_vectors.py`` writes ``stream.json``. The file is for decoders in any
language; all in it is integers or hexadecimal.

    fixed          docs/wire.md's tables: usual steps, tables, first sides, fineness, frequencies
    performance    faces: shapes in units of 2^-12, poses (rotation, translation) of 2^-14; the
                   last one is held for so many faces more
    streams        by quality, of each frame: multiple, payload, whether the sender falls silent,
                   coefficients
    rests          frames that hold what is left of latents: payload, coefficients
    damaged        payloads: coefficients, or null for refused
"""

import json
import random
import sys
from pathlib import Path
from typing import Any

import numpy as np

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))

from helpers.stream_toy import Publisher, Sent, toy_faces, toy_pose
from pica_core.codec.latent_stream import (
    COEFFICIENTS,
    FINENESS,
    HEADER_TABLE,
    LENGTH_TABLES,
    POSE_UNIT,
    QUALITY_TABLE,
    SHAPE_UNIT,
    decode_frame,
    encode_frame,
)
from pica_core.codec.range_coder import Table
from pica_core.errors import LatentError

GOLDEN = Path(__file__).with_name("stream.json")
QUALITIES = (0, 2, 7)


def frequencies(table: Table) -> list[int]:
    """The numbers that a table was made of."""
    return [frequency for _, frequency in table.ranges]


def encode_stream(vectors: dict[str, Any], quality: int) -> list[Sent]:
    """What today's encoder makes of the faces of a golden file."""
    performance = vectors["performance"]
    shapes = np.array(performance["shapes"], np.float64) * SHAPE_UNIT
    poses = np.array(performance["poses"], np.float64) * POSE_UNIT
    moment = np.minimum(np.arange(len(shapes) + performance["num_held"]), len(shapes) - 1)
    return Publisher(quality=quality).show_all(shapes[moment], poses.reshape(-1, 2, 3)[moment])


def decoded(payload: bytes) -> list[int] | None:
    """Coefficients of a payload; None if it is refused."""
    try:
        coefficients: list[int] = decode_frame(payload)[0].tolist()
    except LatentError:
        return None
    return coefficients


def made_vectors() -> dict[str, Any]:
    """Everything of the file."""
    rng = random.Random(1)
    vectors: dict[str, Any] = {
        "fixed": {
            "steps": [each.step for each in COEFFICIENTS],
            "tables": [LENGTH_TABLES.index(each.table) for each in COEFFICIENTS],
            "first": [each.first for each in COEFFICIENTS],
            "fineness": FINENESS,
            "quality_table": frequencies(QUALITY_TABLE),
            "header_table": frequencies(HEADER_TABLE),
            "length_tables": [frequencies(table) for table in LENGTH_TABLES],
        },
        "performance": {
            "shapes": np.rint(toy_faces(1, 40) / SHAPE_UNIT).astype(int).tolist(),
            "poses": np.rint(toy_pose(1, 40) / POSE_UNIT).astype(int).reshape(-1, 6).tolist(),
            "num_held": 40,
        },
        "streams": {},
        "rests": [],
        "damaged": [],
    }
    for quality in QUALITIES:
        frames = []
        for sent in encode_stream(vectors, quality):
            coefficients, is_still = decode_frame(sent.payload)
            frames.append(
                {
                    "multiple": sent.multiple,
                    "payload": sent.payload.hex(),
                    "is_still": is_still,
                    "coefficients": coefficients.tolist(),
                }
            )
            flipped = bytearray(sent.payload)
            flipped[rng.randrange(len(flipped))] ^= 1 << rng.randrange(8)
            for payload in (bytes(flipped), sent.payload[:-1], sent.payload + b"\1"):
                vectors["damaged"].append(
                    {"payload": payload.hex(), "coefficients": decoded(payload)}
                )
        vectors["streams"][str(quality)] = frames
    for reach in (0, 1, 40):
        numbers = [abs(rng.randint(-3, 3)) for _ in range(58)]
        rest = [rng.randint(-reach, reach) for _ in range(255)]
        payload = encode_frame([*numbers, *rest, 1], 3)
        vectors["rests"].append({"payload": payload.hex(), "coefficients": decoded(payload)})
    return vectors


def to_text(vectors: dict[str, Any]) -> str:
    """JSON with one frame or array a line."""
    text = json.dumps(vectors, separators=(",", ":"))
    for opening in ('{"multiple"', '{"payload"', '"fixed"', "[[", '"performance"'):
        text = text.replace(opening, "\n" + opening)
    return text.replace("],[", "],\n[") + "\n"


if __name__ == "__main__":
    GOLDEN.write_text(to_text(made_vectors()))
