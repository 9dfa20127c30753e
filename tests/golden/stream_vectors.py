"""Golden vectors of the latent bitstream: tables, faces, payloads and what they decode to.

``python tests/golden/stream_vectors.py`` writes ``stream.json``. The file is for decoders in any
language; all in it is integers or hexadecimal.

    profile        the arrays of docs/wire.md: type, shape, values row after row
    fixed          what is the same for all profiles: steps by quality, and frequencies
    performance    faces: latents in units of 2^-12, poses (rotation, translation) of 2^-14; the
                   last one is held for so many faces more
    streams        by quality, of each frame: multiple, payload, whether the sender falls silent,
                   coefficients, and the SHA-256 of the latent as 256 little-endian int32 in units
                   of 2^-12
    damaged        payloads: coefficients, or null for refused
"""

import hashlib
import json
import random
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))

from helpers.stream_toy import Publisher, Sent, toy_faces, toy_pose, toy_profile
from pica_core.codec.latent_stream import (
    HEADER_TABLE,
    POSE_TABLES,
    QUALITY_TABLE,
    STEPS,
    decode_frame,
)
from pica_core.codec.profile import StreamProfile, Table, coefficient_frequencies
from pica_core.errors import LatentError

GOLDEN = Path(__file__).with_name("stream.json")
LATENT_UNIT, POSE_UNIT = 2.0**-12, 2.0**-14
QUALITIES = (0, 2, 7)
FRAME_TABLES = {"quality_table": QUALITY_TABLE, "header_table": HEADER_TABLE}


def frequencies(table: Table) -> list[int]:
    """The numbers that a table was made of."""
    return [frequency for _, frequency in table.ranges]


def read_profile(vectors: dict[str, Any]) -> StreamProfile:
    """The profile of a golden file."""
    return StreamProfile(
        **{
            name: np.array(array["values"], array["type"]).reshape(array["shape"])
            for name, array in vectors["profile"].items()
        }
    )


def encode_stream(vectors: dict[str, Any], quality: int) -> list[Sent]:
    """What today's encoder makes of the faces of a golden file."""
    performance = vectors["performance"]
    latents = np.array(performance["latents"], np.float64) * LATENT_UNIT
    poses = np.array(performance["poses"], np.float64) * POSE_UNIT
    moment = np.minimum(np.arange(len(latents) + performance["num_held"]), len(latents) - 1)
    publisher = Publisher(read_profile(vectors), quality=quality)
    return publisher.show_all(latents.reshape(-1, 8, 8, 4)[moment], poses.reshape(-1, 2, 3)[moment])


def latent_units(profile: StreamProfile, coefficients: npt.NDArray[np.int64]) -> list[int]:
    """The latent of coefficients in whole units of 2^-12."""
    latent = profile.synthesise(coefficients[: profile.num_components]).astype(np.float64)
    units: list[int] = (latent / LATENT_UNIT).astype(np.int64).tolist()
    return units


def units_hash(units: list[int]) -> str:
    """SHA-256 of numbers as little-endian int32."""
    return hashlib.sha256(np.array(units, "<i4").tobytes()).hexdigest()


def decoded(profile: StreamProfile, payload: bytes) -> list[int] | None:
    """Coefficients of a payload; None if it is refused."""
    try:
        coefficients: list[int] = decode_frame(profile, payload)[0].tolist()
    except LatentError:
        return None
    return coefficients


def made_vectors() -> dict[str, Any]:
    """Everything of the file."""
    talk, nod, profile, rng = toy_faces(1, 40), toy_pose(1, 40), toy_profile(), random.Random(1)
    vectors: dict[str, Any] = {
        "profile": {
            name.removeprefix("stream."): {
                "type": str(array.dtype),
                "shape": list(array.shape),
                "values": array.reshape(-1).tolist(),
            }
            for name, array in sorted(profile.to_tensors().items())
        },
        "fixed": {
            "steps": STEPS,
            **{name: frequencies(table) for name, table in FRAME_TABLES.items()},
            "pose_tables": [frequencies(table) for table in POSE_TABLES],
            "tables": coefficient_frequencies().tolist(),
        },
        "performance": {
            "latents": np.rint(talk / LATENT_UNIT).astype(int).reshape(-1, 256).tolist(),
            "poses": np.rint(nod / POSE_UNIT).astype(int).reshape(-1, 6).tolist(),
            "num_held": 40,
        },
        "streams": {},
        "damaged": [],
    }
    for quality in QUALITIES:
        frames = []
        for sent in encode_stream(vectors, quality):
            coefficients, is_still = decode_frame(profile, sent.payload)
            frames.append(
                {
                    "multiple": sent.multiple,
                    "payload": sent.payload.hex(),
                    "is_still": is_still,
                    "coefficients": coefficients.tolist(),
                    "latent_sha256": units_hash(latent_units(profile, coefficients)),
                }
            )
            flipped = bytearray(sent.payload)
            flipped[rng.randrange(len(flipped))] ^= 1 << rng.randrange(8)
            for payload in (bytes(flipped), sent.payload[:-1], sent.payload + b"\1"):
                vectors["damaged"].append(
                    {"payload": payload.hex(), "coefficients": decoded(profile, payload)}
                )
        vectors["streams"][str(quality)] = frames
    return vectors


def to_text(vectors: dict[str, Any]) -> str:
    """JSON with one frame or array a line."""
    text = json.dumps(vectors, separators=(",", ":"))
    for opening in ('{"multiple"', '{"payload"', '{"type"', '"fixed"', "[[", '"performance"'):
        text = text.replace(opening, "\n" + opening)
    return text.replace("],[", "],\n[") + "\n"


if __name__ == "__main__":
    GOLDEN.write_text(to_text(made_vectors()))
