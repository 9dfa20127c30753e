"""Hypothesis strategies for messages and frames within their limits."""

import string
from dataclasses import fields

from hypothesis import strategies as st

from pica_protocol.frames import MAX_PAYLOAD_BYTES, Frame
from pica_protocol.limits import MAX_DEADLINE_MS, MAX_PASS_BYTES, MAX_WHISPER_BYTES, draws_nothing
from pica_protocol.messages import BYE_CODES, MESSAGE_TYPES, Message, Peer, Track

_TOKEN_CHARS = string.ascii_letters + string.digits + "_.-"

tokens = st.text(_TOKEN_CHARS, min_size=1, max_size=64)
streams = st.integers(1, 65_535)
texts = st.text(max_size=15).filter(str.isprintable)
names = texts.filter(lambda text: not all(map(draws_nothing, text)))
metadata = st.dictionaries(
    st.text(_TOKEN_CHARS, min_size=1, max_size=16), texts | st.just("x" * 64), max_size=8
).map(lambda entries: tuple(entries.items()))
secrets = st.just("") | tokens


def tracks(stream: st.SearchStrategy[int]) -> st.SearchStrategy[tuple[Track, ...]]:
    """Up to four tracks, with streams of the given kind."""
    fields = {
        "kind": st.text(_TOKEN_CHARS, min_size=1, max_size=16),
        "avatar": st.sampled_from(["", "0f" * 32]),
        "stream": stream,
    }
    ordered = {"deadline_ms": st.integers(1, MAX_DEADLINE_MS)}
    track = st.builds(Track, **fields) | st.builds(Track, **fields, **ordered)
    return st.lists(track, max_size=4).map(tuple)


peers = st.builds(
    Peer,
    peer_id=tokens,
    name=names,
    tracks=tracks(streams),
    metadata=metadata,
    identity=secrets,
    is_name_assured=st.booleans(),
)
_FIELDS: dict[str, st.SearchStrategy[object]] = {
    **dict.fromkeys(("room", "peer_id", "identity"), tokens),
    **dict.fromkeys(("resumable", "resumed", "is_admin"), st.booleans()),
    **dict.fromkeys(("is_muted", "is_barred", "is_away"), st.booleans()),
    "name": names,
    "joined.name": texts,
    "reason": texts,
    "resume": secrets,
    "token": secrets | st.just("x" * MAX_PASS_BYTES),
    "metadata": metadata,
    "tracks": tracks(streams),
    "join.tracks": tracks(st.just(0)),
    "peer": peers,
    "peers": st.lists(peers, max_size=3).map(tuple),
    "stream": streams,
    "every": st.sampled_from((0, 1, 2, 4)),
    "data": st.binary(max_size=20) | st.just(bytes(MAX_WHISPER_BYTES)),
    "kind": st.sampled_from(("face", "voice")),
    "code": st.sampled_from(BYE_CODES) | st.integers(3000, 4999),
    "sha256": st.just("ab" * 32),
    "size": st.integers(1, 2**40),
    "is_new": st.booleans(),
    "url": st.sampled_from(("", "ws://a", "wss://[::1]:8765/pica", "wss://b.example.org:443")),
}
"""What a field of a message may hold: by its name, or by that of the message before it."""


def _message(wire: str, cls: type[Message]) -> st.SearchStrategy[Message]:
    return st.builds(
        cls,
        **{
            field.name: _FIELDS.get(f"{wire}.{field.name}", _FIELDS.get(field.name))
            for field in fields(cls)
        },
    )


messages: st.SearchStrategy[Message] = st.one_of(
    *(_message(wire, cls) for wire, cls in MESSAGE_TYPES.items())
)
frames = st.builds(
    Frame,
    stream=streams,
    sequence=st.integers(0, 65_535),
    captured_us=st.integers(0, 2**64 - 1),
    payload=st.binary(max_size=40) | st.just(bytes(MAX_PAYLOAD_BYTES)),
)
