"""Hypothesis strategies for messages and frames within their limits."""

import string

from hypothesis import strategies as st

from pica_protocol.frames import MAX_PAYLOAD_BYTES, Frame
from pica_protocol.limits import (
    MAX_DEADLINE_MS,
    MAX_PASS_BYTES,
    MAX_WHISPER_BYTES,
    draws_nothing,
)
from pica_protocol.messages import (
    BYE_CODES,
    BarIdentity,
    Bye,
    Join,
    Joined,
    Leave,
    Message,
    MutePeer,
    Peer,
    PeerAway,
    PeerBack,
    PeerJoined,
    PeerLeft,
    PeerUpdated,
    RemovePeer,
    StreamMuted,
    Subscribe,
    Track,
    UpdateMetadata,
    Whisper,
)

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
    ordered = {"policy": st.just("ordered"), "deadline_ms": st.integers(1, MAX_DEADLINE_MS)}
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

messages: st.SearchStrategy[Message] = st.one_of(
    st.builds(
        Join,
        room=tokens,
        name=names,
        tracks=tracks(st.just(0)),
        token=st.just("") | tokens | st.just("x" * MAX_PASS_BYTES),
        metadata=metadata,
        resumable=st.booleans(),
        resume=secrets,
    ),
    st.builds(
        Joined,
        room=tokens,
        peer_id=tokens,
        tracks=tracks(streams),
        peers=st.lists(peers, max_size=3).map(tuple),
        resumed=st.booleans(),
        resume=secrets,
        name=texts,
        is_admin=st.booleans(),
    ),
    st.builds(PeerJoined, peer=peers),
    st.builds(PeerLeft, peer_id=tokens, reason=texts),
    st.builds(PeerAway, peer_id=tokens),
    st.builds(PeerBack, peer_id=tokens),
    st.builds(PeerUpdated, peer_id=tokens, metadata=metadata),
    st.builds(StreamMuted, stream=streams, is_muted=st.booleans()),
    st.builds(UpdateMetadata, metadata=metadata),
    st.builds(Leave),
    st.builds(Subscribe, stream=streams, every=st.sampled_from((0, 1, 2, 4))),
    st.builds(
        Whisper, peer_id=tokens, data=st.binary(max_size=20) | st.just(bytes(MAX_WHISPER_BYTES))
    ),
    st.builds(RemovePeer, peer_id=tokens),
    st.builds(
        MutePeer, peer_id=tokens, kind=st.sampled_from(("face", "voice")), is_muted=st.booleans()
    ),
    st.builds(BarIdentity, identity=tokens, is_barred=st.booleans()),
    st.builds(
        Bye,
        code=st.sampled_from(BYE_CODES) | st.integers(3000, 4999),
        reason=texts,
        url=st.sampled_from(("", "ws://a", "wss://[::1]:8765/pica", "wss://b.example.org:443")),
    ),
)

frames = st.builds(
    Frame,
    stream=streams,
    sequence=st.integers(0, 65_535),
    captured_us=st.integers(0, 2**64 - 1),
    payload=st.binary(max_size=40) | st.just(bytes(MAX_PAYLOAD_BYTES)),
)
