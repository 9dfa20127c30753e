"""Golden vectors of the latent bitstream: tables, faces, payloads and what they decode to.

``python tests/golden/stream_vectors.py`` writes ``stream_v1.json`` anew. Its profile and its faces
stay as they are for ever, and so does every payload that an older encoder made: where today's
encoder makes other bytes of the same faces, the former ones are moved to ``older``, and they must
still decode.

The file is for decoders in any language; all in it is integers or hexadecimal.

    profile        the arrays of docs/bitstream.md: type, shape, values row after row
    profile_hash   their SHA-256, as the handshake names them
    performance    faces: latents in units of 2^-12, poses (rotation, translation) of 2^-14; the
                   last one is held for so many faces more
    streams        by name: how encoded; and of each frame the header, the payload, and what it
                   holds: quality, whether the sender falls silent, coefficients, and the SHA-256
                   of the latent as 256 little-endian int32 in units of 2^-12
    latents        of one frame of each stream, in full
    damaged        payloads in the place of a stream's frame: coefficients, or null for refused
    older          as streams
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
from pica_core.codec.frames import FrameState, decode_frame
from pica_core.codec.latent_stream import StreamConfig
from pica_core.codec.profile import StreamProfile
from pica_core.errors import LatentError

GOLDEN = Path(__file__).with_name("stream_v1.json")
LATENT_UNIT = 2.0**-12
POSE_UNIT = 2.0**-14
ASKED_AT = 37
"""A keyframe is asked for before this face."""

CONFIGS: dict[str, dict[str, Any]] = {
    "three layers": {"quality": 3},
    "finest": {"quality": 7, "num_layers": 2},
    "coarsest": {"quality": 0, "num_layers": 1},
    "held to 800 bit/s": {"target_bps": 800, "keyframe_interval_s": 0.5},
}
FIRST_NUMBERS = {"three layers": 0, "finest": 65_500, "coarsest": 7, "held to 800 bit/s": 300}


def read_profile(vectors: dict[str, Any]) -> StreamProfile:
    """The profile of a golden file."""
    return StreamProfile(
        **{
            name: np.array(array["values"], array["type"]).reshape(array["shape"])
            for name, array in vectors["profile"].items()
        }
    )


def read_faces(vectors: dict[str, Any]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Latents ``[T, 8, 8, 4]`` and poses ``[T, 2, 3]`` of a golden file."""
    performance = vectors["performance"]
    latents = np.array(performance["latents"], np.float64) * LATENT_UNIT
    poses = np.array(performance["poses"], np.float64) * POSE_UNIT
    moment = np.minimum(np.arange(len(latents) + performance["num_held"]), len(latents) - 1)
    return latents.reshape(-1, 8, 8, 4)[moment], poses.reshape(-1, 2, 3)[moment]


def encode_stream(vectors: dict[str, Any], name: str) -> list[Sent]:
    """What today's encoder makes of the faces of a golden file."""
    publisher = Publisher(
        StreamConfig(**CONFIGS[name]),
        first_number=FIRST_NUMBERS[name],
        profile=read_profile(vectors),
    )
    faces, poses = read_faces(vectors)
    for index, (face, pose) in enumerate(zip(faces, poses, strict=True)):
        if index == ASKED_AT:
            publisher.encoder.request_keyframe()
        publisher.show(face, pose, index * 33_333)
    return publisher.sent


def latent_units(profile: StreamProfile, coefficients: npt.NDArray[np.int64]) -> list[int]:
    """The latent of coefficients in whole units of 2^-12."""
    latent = profile.synthesise(coefficients[: profile.num_components]).astype(np.float64)
    units: list[int] = (latent / LATENT_UNIT).astype(np.int64).tolist()
    return units


def units_hash(units: list[int]) -> str:
    """SHA-256 of numbers as little-endian int32."""
    return hashlib.sha256(np.array(units, "<i4").tobytes()).hexdigest()


def _decode(
    profile: StreamProfile, frame: Sent, payload: bytes, stream: list[Sent]
) -> tuple[FrameState, bool]:
    return decode_frame(
        profile,
        payload,
        sequence=frame.number,
        layer=frame.layer,
        is_keyframe=frame.is_keyframe,
        references={sent.number: sent.state for sent in stream if sent.number < frame.number},
    )


def _frame_to_json(profile: StreamProfile, frame: Sent, stream: list[Sent]) -> dict[str, Any]:
    state, is_still = _decode(profile, frame, frame.payload, stream)
    return {
        "sequence": frame.sequence,
        "captured_us": frame.captured_us,
        "layer": frame.layer,
        "is_keyframe": frame.is_keyframe,
        "payload": frame.payload.hex(),
        "quality": state.quality,
        "is_still": is_still,
        "coefficients": state.coefficients.tolist(),
        "latent_sha256": units_hash(latent_units(profile, state.coefficients)),
    }


def _damaged(profile: StreamProfile, name: str, stream: list[Sent]) -> list[dict[str, Any]]:
    rng = random.Random(name)
    entries = []
    for index in range(0, len(stream), 4):
        frame = stream[index]
        flipped = bytearray(frame.payload or b"\1")
        flipped[rng.randrange(len(flipped))] ^= 1 << rng.randrange(8)
        for payload in (
            frame.payload[:-1],
            bytes(flipped),
            frame.payload + b"\1",
            frame.payload + b"\0",
            rng.randbytes(len(frame.payload) + 3),
        ):
            try:
                coefficients = _decode(profile, frame, payload, stream)[0].coefficients.tolist()
            except LatentError:
                coefficients = None
            entries.append(
                {
                    "stream": name,
                    "frame": index,
                    "payload": payload.hex(),
                    "coefficients": coefficients,
                }
            )
    return entries


def _first_vectors() -> dict[str, Any]:
    """Tables and faces, when there is no file yet."""
    talk, nod, profile = toy_faces(1, 46), toy_pose(1, 46), toy_profile()
    return {
        "profile": {
            name.removeprefix("stream."): {
                "type": str(array.dtype),
                "shape": list(array.shape),
                "values": array.reshape(-1).tolist(),
            }
            for name, array in sorted(profile.to_tensors().items())
        },
        "profile_hash": profile.hash,
        "performance": {
            "latents": np.rint(talk / LATENT_UNIT).astype(int).reshape(-1, 256).tolist(),
            "poses": np.rint(nod / POSE_UNIT).astype(int).reshape(-1, 6).tolist(),
            "num_held": 40,
        },
        "older": [],
    }


def renewed(vectors: dict[str, Any]) -> dict[str, Any]:
    """The vectors with what today's encoder makes; what it makes no more is kept as older."""
    profile = read_profile(vectors)
    older = list(vectors["older"])
    streams: dict[str, Any] = {}
    latents: list[dict[str, Any]] = []
    damaged: list[dict[str, Any]] = []
    for name, config in CONFIGS.items():
        sent = encode_stream(vectors, name)
        frames = [_frame_to_json(profile, frame, sent) for frame in sent]
        streams[name] = {"config": config, "frames": frames}
        former = vectors.get("streams", {}).get(name)
        if former is not None and former["frames"] != frames:
            older.append(former)
        last = len(sent) - 1
        units = latent_units(profile, sent[last].state.coefficients)
        latents.append({"stream": name, "frame": last, "units": units})
        damaged += _damaged(profile, name, sent)
    return {**vectors, "streams": streams, "latents": latents, "damaged": damaged, "older": older}


def to_text(vectors: dict[str, Any]) -> str:
    """JSON with one frame or array a line."""
    text = json.dumps(vectors, separators=(",", ":"))
    for opening in ('{"sequence"', '{"stream"', '{"config"', '{"type"', "[[", '"performance"'):
        text = text.replace(opening, "\n" + opening)
    return text.replace("],[", "],\n[") + "\n"


if __name__ == "__main__":
    before = json.loads(GOLDEN.read_text()) if GOLDEN.exists() else _first_vectors()
    GOLDEN.write_text(to_text(renewed(before)))
