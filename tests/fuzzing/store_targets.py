"""More to throw damaged messages at: the avatar store's door."""

from __future__ import annotations

import json
import random
from http import HTTPStatus
from typing import Any, Final

from fuzzing.corpus import GOLDEN_BYTES
from fuzzing.meter import Meter
from fuzzing.mutator import INTEGERS, TEXTS, Mutator
from fuzzing.targets import expect, refusal
from pica_protocol.codec import decode_store_message, encode_message
from pica_protocol.errors import RemoteProtocolError
from pica_protocol.store import MAX_CHUNK_BYTES, decode_chunk, is_avatar_id
from pica_server.errors import UnfitFileError
from pica_server.store.check import StructureCheck
from pica_server.store.downloads import answer_for

_STORE_CORPUS: Final = [
    data
    for name, data in GOLDEN_BYTES.items()
    if any(word in name for word in ("offer", "ready", "stored", "chunk", "bye", "hello"))
]
_AVATAR: Final = "0f" * 32


def store_messages(rng: random.Random, meter: Meter) -> None:
    """Messages of an upload, and pieces of a file."""
    mutator = Mutator(rng, _STORE_CORPUS)
    for _ in range(40):
        data = mutator.mutate(rng.choice(_STORE_CORPUS))
        try:
            if data[:1] == b"\x03":
                piece = meter.call(decode_chunk, data)
                expect(0 < len(piece) <= MAX_CHUNK_BYTES, "a piece of a wrong size:", len(piece))
            else:
                message = meter.call(decode_store_message, data, 16_384)
                again = decode_store_message(encode_message(message))
                expect(again == message, "written and read again it differs:", data)
        except RemoteProtocolError as error:
            meter.note(refusal(error.code))
            continue
        meter.note("accepted")


def structure(rng: random.Random, meter: Meter) -> None:
    """Files that are nearly avatar files, in pieces."""
    for _ in range(10):
        file = _file(rng)
        if rng.random() < 0.5:
            file = Mutator(rng, [file]).mutate_bytes(file)
        check = StructureCheck(len(file) or 1)
        at = 0
        try:
            while at < len(file):
                size = rng.choice((1, 7, 100, MAX_CHUNK_BYTES))
                meter.call(check.receive, file[at : at + size])
                at += size
            meter.call(check.finish)
        except UnfitFileError as error:
            expect(str(error).isascii() and len(str(error)) < 200, "a wild error:", str(error))
            meter.note("refused UNFIT_FILE")
            continue
        meter.note("accepted")


def _file(rng: random.Random) -> bytes:
    """Return something like a safetensors file."""
    header: Any = {"__metadata__": {"pica": "{}"}}
    at = 0
    for number in range(rng.choice((0, 1, 3, 1030))):
        shape = [rng.choice((0, 1, 2, 8)) for _ in range(rng.choice((0, 1, 2, 9)))]
        size = rng.choice((1, 2, 4))
        for length in shape:
            size *= length
        kind = {1: "U8", 2: "F16"}.get(size, "F32")
        header[f"t{number}"] = {"dtype": kind, "shape": shape, "data_offsets": [at, at + size]}
        at += size
    for _ in range(rng.choice((0, 0, 1, 2))):
        place = header
        while isinstance(place, dict) and place and rng.random() < 0.7:
            key = rng.choice(list(place))
            if not isinstance(place[key], dict):
                place[key] = rng.choice((*INTEGERS, *TEXTS, None, [], {}, [[]], 1.5, 10**30))
                break
            place = place[key]
    if rng.random() < 0.05:
        header = rng.choice(([], 3, "x", None))
    text = json.dumps(header).encode()
    if rng.random() < 0.1:
        text = rng.choice((b"[" * 5000, b'{"a":' * 3000, b"NaN", b"9" * 5000, b'{"a":1,"a":2}'))
    return len(text).to_bytes(8, "little") + text + bytes(min(at, 10_000))


def ranges(rng: random.Random, meter: Meter) -> None:
    """Headers of a request for a file: whatever they say, the answer lies within the file."""
    mutator = Mutator(rng, [b"bytes=0-99", b"bytes=-5", f'W/"{_AVATAR}"'.encode()])
    for _ in range(40):
        size = rng.choice((1, 100, 10**6))
        texts = [
            mutator.mutate_bytes(text).decode("latin-1") if rng.random() < 0.7 else text.decode()
            for text in (
                rng.choice((b"", b"bytes=0-", b"bytes=5-7", b"bytes=-8", b"bytes=0-1,3-4")),
                rng.choice((b"", f'"{_AVATAR}"'.encode())),
            )
        ]
        conditions = dict(zip(("Range", "If-Range"), texts, strict=False))
        answer = meter.call(answer_for, _AVATAR, size, conditions)
        expect(0 <= answer.begin <= answer.end <= size, "bytes that are not there:", answer)
        plain = all(value.isprintable() for value in answer.headers.values())
        expect(plain, "a header that breaks out of its line:", answer)
        meter.note("accepted" if answer.status < 400 else f"refused HTTP {answer.status.value}")
        known = (HTTPStatus.OK, HTTPStatus.PARTIAL_CONTENT)
        is_known = answer.status in (*known, HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE)
        expect(is_known, "a status that nobody documents:", answer)
        path = mutator.mutate_bytes(_AVATAR.encode()).decode("latin-1")
        if is_avatar_id(path):
            expect(len(path) == 64 and path.isalnum(), "an id with tricks in it:", path)
