"""A hundred thousand damaged payloads: each a typed error or a bounded, finite face."""

from __future__ import annotations

import contextlib
import functools
import gc
import os
import random
import subprocess
import sys
import tracemalloc
from collections import Counter
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from helpers.stream_toy import (
    Publisher,
    Sent,
    deliver_all,
    other_profile,
    perform,
    toy_faces,
    toy_pose,
    toy_profile,
)
from pica_core.avatar.file import load_avatar
from pica_core.codec import frames as stream_frames
from pica_core.codec.frames import decode_frame
from pica_core.codec.latent_sample import ReceivedFrame
from pica_core.codec.latent_stream import LatentDecoder, StreamConfig
from pica_core.codec.profile import MAX_COEFFICIENT, StreamProfile
from pica_core.codec.range_coder import SymbolReader, Table
from pica_core.errors import LatentError

pytestmark = [pytest.mark.unit, pytest.mark.slow]

NUM_MUTATIONS = 100_000
NUM_BYTES_GROWN = 2**17
"""Memory that a decoder may take, beyond its profile, whatever comes: 128 KiB."""
MAX_POSE = MAX_COEFFICIENT / 2**14

KINDS = (
    "flip one bit",
    "flip bits",
    "cut",
    "extend",
    "splice",
    "noise",
    "long noise",
    "layer",
    "keyframe",
    "number",
    "time",
)


def mutate(rng: random.Random, kind: str, frame: Sent, other: Sent) -> ReceivedFrame:
    """A damaged frame, as `LatentDecoder.receive` takes it."""
    payload = bytearray(frame.payload)
    number, captured_us = frame.number, frame.captured_us
    layer, is_keyframe = frame.layer, frame.is_keyframe
    match kind:
        case "flip one bit" | "flip bits":
            for _ in range(1 if kind == "flip one bit" else rng.randint(2, 12)):
                if payload:
                    payload[rng.randrange(len(payload))] ^= 1 << rng.randrange(8)
        case "cut":
            del payload[rng.randrange(len(payload) + 1) :]
        case "extend":
            payload += rng.randbytes(rng.randint(1, 20))
        case "splice":
            payload[rng.randrange(len(payload) + 1) :] = other.payload[
                rng.randrange(len(other.payload) + 1) :
            ]
        case "noise":
            payload[:] = rng.randbytes(rng.randint(0, 80))
        case "long noise":
            payload[:] = rng.choice([b"\xff", b"\0", rng.randbytes(1)]) * rng.randint(80, 1200)
        case "layer":
            layer = rng.choice([0, 1, 2, 3, 15])
        case "keyframe":
            is_keyframe = not is_keyframe
        case "number":
            number = rng.choice([rng.randrange(65536), number + rng.randint(-20, 20)])
        case "time":
            captured_us = rng.choice([0, 2**63 - 1, captured_us + rng.randint(-(10**6), 10**6)])
    return ReceivedFrame(number, captured_us, layer, is_keyframe, bytes(payload))


@functools.cache
def shipped_profile() -> StreamProfile:
    """The tables of a shipped avatar: larger ones, of 60 components."""
    profile = load_avatar(
        Path(str(resources.files("pica_core"))) / "avatars" / "amara.pica"
    ).stream_profile()
    assert profile is not None
    return profile


def streams(profile: StreamProfile) -> list[list[Sent]]:
    """Streams of several qualities that begin anywhere."""
    made = []
    for seed, quality, first in ((1, 3, 0), (2, 7, 65_500), (3, 0, 400)):
        config = StreamConfig(quality=quality, keyframe_interval_s=1)
        publisher = Publisher(config, first_number=first, profile=profile)
        made.append(publisher.show_all(toy_faces(seed, 120), toy_pose(seed, 120)))
    return made


def decode_mutations(
    encoded_with: StreamProfile, decoded_with: StreamProfile, num_mutations: float
) -> Counter[str]:
    """Hand damaged frames to decoders that have seen sound ones, and check all that they show."""
    rng = random.Random(20)
    sound = streams(decoded_with)
    damaged = sound if encoded_with is decoded_with else streams(encoded_with)
    results: Counter[str] = Counter()
    while results.total() < num_mutations:
        which = rng.randrange(len(sound))
        stream, source = sound[which], damaged[which]
        begin = rng.choice([i for i, frame in enumerate(stream) if frame.is_keyframe])
        end = min(begin + rng.randint(1, 8), len(stream) - 8)
        decoder = LatentDecoder(decoded_with)
        list(deliver_all(decoder, stream[begin:end]))
        for frame in source[end : end + 8]:
            wire = mutate(rng, rng.choice(KINDS), frame, rng.choice(source))
            try:
                shown = decoder.receive(wire)
            except LatentError:
                results["refused"] += 1
                continue
            results["shown" if shown else "held"] += 1
            for face in shown:
                assert face.sample.latent.dtype == np.float32
                assert np.abs(face.sample.latent).max() <= 256  # which NaN is not
                assert np.abs(face.sample.rotation).max() <= MAX_POSE
                assert np.abs(face.sample.translation_m).max() <= MAX_POSE
    return results


@pytest.mark.parametrize(
    ("encoded_with", "decoded_with", "share"),
    [
        (toy_profile, toy_profile, 0.6),
        (toy_profile, other_profile, 0.2),
        (shipped_profile, shipped_profile, 0.2),
    ],
    ids=["toy", "wrong tables", "shipped"],
)
def test_any_mutation_is_a_latent_error_or_a_bounded_finite_face(
    encoded_with: Callable[[], StreamProfile],
    decoded_with: Callable[[], StreamProfile],
    share: float,
) -> None:
    results = decode_mutations(encoded_with(), decoded_with(), share * NUM_MUTATIONS)
    # The test is worth something only if all of this happened often.
    assert min(results["refused"], results["shown"], results["held"]) > 0.1 * results.total()


def memory_taken(num_times: int) -> list[int]:
    """The most bytes that two thousand damaged frames made a new decoder take, each time."""
    decode_mutations(toy_profile(), toy_profile(), 50)  # what is prepared once is there now
    rng, stream = random.Random(3), perform(1, 60)
    taken = []
    for _ in range(num_times):
        gc.collect()
        tracemalloc.start()
        decoder = LatentDecoder(toy_profile())
        for number in range(2000):
            frame = stream[number // 2 % len(stream)]
            with contextlib.suppress(LatentError):
                decoder.receive(mutate(rng, rng.choice(KINDS), frame, rng.choice(stream)))
        taken.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    return taken


def test_a_decoder_takes_no_memory_for_damaged_payloads() -> None:
    # In a process of its own: threads that other tests left behind would be counted with it.
    ended = subprocess.run(
        [sys.executable, __file__],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        check=True,
    )
    taken = [int(word) for word in ended.stdout.split()]
    assert len(taken) == 3
    assert max(taken) < NUM_BYTES_GROWN


class CountingReader(SymbolReader):
    """Counts what it is asked for."""

    num_read = 0

    def read(self, table: Table) -> int:
        CountingReader.num_read += 1
        return super().read(table)

    def read_uniform(self, num_bits: int) -> int:
        CountingReader.num_read += 1
        return super().read_uniform(num_bits)


def test_no_payload_makes_a_decoder_work_for_long() -> None:
    # Reference, quality, header, and for each coefficient a residual with an escape and its rest.
    for_one = 3 + 3 * toy_profile().num_coefficients
    rng = random.Random(7)
    decoder = LatentDecoder(toy_profile())
    stream = perform(1, 60)
    most = 0
    with mock.patch.object(stream_frames, "SymbolReader", CountingReader):
        for number in range(3000):
            frame = stream[number // 3 % len(stream)]
            kind = rng.choice(KINDS)
            CountingReader.num_read = 0
            with contextlib.suppress(LatentError):
                decoder.receive(mutate(rng, kind, frame, rng.choice(stream)))
            most = max(most, CountingReader.num_read)
    # Itself, and eight that waited, each tried again after each of them.
    assert for_one / 3 < most <= for_one * (1 + 8 + 7 + 6 + 5 + 4 + 3 + 2 + 1)


@pytest.mark.parametrize("quality", [0, 3, 7])
def test_every_truncation_of_every_frame_is_an_error_or_another_frame(quality: int) -> None:
    stream = perform(4, 40, StreamConfig(quality=quality))
    references = {frame.number: frame.state for frame in stream}
    for frame in stream:
        for size in range(len(frame.payload)):
            with contextlib.suppress(LatentError):
                state, _ = decode_frame(
                    toy_profile(),
                    frame.payload[:size],
                    sequence=frame.number,
                    layer=frame.layer,
                    is_keyframe=frame.is_keyframe,
                    references=references,
                )
                assert np.abs(state.coefficients).max() <= MAX_COEFFICIENT


if __name__ == "__main__":
    print(*memory_taken(3))
