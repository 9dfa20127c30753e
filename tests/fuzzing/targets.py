"""What damaged messages are thrown at, and what may come of it.

Each target takes a source of chance and a meter, throws some dozens of messages, and raises
`Violation` when something happens that is not documented. Any other exception that leaves a target
is a defect too.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from fuzzing.corpus import CORPUS, FACE, media, shuffled, to_client, to_relay
from fuzzing.meter import Meter, Violation
from fuzzing.mutator import Mutator
from pica_protocol.client_session import MAX_QUEUED_MESSAGES, ClientSession
from pica_protocol.codec import decode_message, encode_message
from pica_protocol.errors import CloseCode, RemoteProtocolError
from pica_protocol.frames import HEADER_BYTES, decode_media, encode_frame, scan_frames
from pica_protocol.limits import (
    MAX_CLIENT_MESSAGE_BYTES,
    MAX_CONTROL_BYTES,
    MAX_PEERS,
)
from pica_protocol.messages import Bye, Join, Joined, Peer, PeerAway, PeerJoined, Subscribe, Track
from pica_protocol.server_session import ServerSession
from pica_protocol.session import Closed, State

Target = Callable[[random.Random, Meter], None]

OUR_CODES: Final = frozenset(map(int, CloseCode))


def expect(condition: bool, what: str, *details: object) -> None:
    """Raise a violation unless something holds."""
    if not condition:
        raise Violation(" ".join([what, *map(repr, details)]))


def refusal(code: int) -> str:
    """Name a close code, which must be a documented one."""
    expect(code in OUR_CODES, "closed with a code that nobody documents:", code)
    return f"refused {CloseCode(code).name}"


def codec(rng: random.Random, meter: Meter) -> None:
    """Control messages: read and written again they are the same."""
    mutator = Mutator(rng, CORPUS)
    for _ in range(50):
        data = mutator.mutate(rng.choice(CORPUS))
        limit = rng.choice((MAX_CLIENT_MESSAGE_BYTES, MAX_CONTROL_BYTES))
        try:
            message = meter.call(decode_message, data, limit)
        except RemoteProtocolError as error:
            meter.note(refusal(error.code))
            continue
        again = decode_message(encode_message(message))
        expect(again == message, "written and read again it differs:", data, message)
        meter.note("accepted")


def frames(rng: random.Random, meter: Meter) -> None:
    """Media messages: the frames found fill the message, and are the same to relay and client."""
    mutator = Mutator(rng, CORPUS)
    for _ in range(50):
        data = mutator.mutate(media(rng, 1, num_frames=rng.choice((1, 2, 9))))
        try:
            spans = meter.call(scan_frames, data)
        except RemoteProtocolError as error:
            meter.note(refusal(error.code))
            continue
        decoded = meter.call(decode_media, data)
        expect(len(spans) == len(decoded) > 0, "relay and client disagree:", data)
        at = 1
        for (_, _, start, end), frame in zip(spans, decoded, strict=True):
            expect(start == at and end - at >= HEADER_BYTES, "a gap:", data)
            at = end
            expect(encode_frame(frame) == data[start:end], "written again it differs:", data)
        expect(at == len(data), "bytes left over:", data)
        meter.note("accepted")


def server_session(rng: random.Random, meter: Meter) -> None:
    """The relay's end of a connection, in every state."""
    mutator = Mutator(rng, CORPUS)
    session = ServerSession(now=0.0, timeout_s=5.0)
    now = 0.0
    for data in shuffled(rng, to_relay(rng) + [rng.choice(CORPUS) for _ in range(4)]):
        now += rng.choice((0.0, 0.0, 0.01, 1.0))
        # Few of them: after the first that is refused there is nothing left to see.
        is_damaged = rng.random() < 0.2
        sent: bytes | str = mutator.mutate(data) if is_damaged else data
        if is_damaged and rng.random() < 0.05:
            sent = data.decode("latin-1")
        before = session.state
        events = meter.call(session.receive_data, sent, now)
        _note_session(session, meter, before, is_damaged=is_damaged)
        if before is State.CLOSED:
            expect(not events, "events after the end:", events)
            break
        if session.state is State.DECIDING and rng.random() < 0.8:
            join = next(event for event in events if isinstance(event, Join))
            own = tuple(replace(track, stream=7 + i) for i, track in enumerate(join.tracks))
            session.accept(Joined(room=join.room, peer_id="p2", tracks=own))
        if rng.random() < 0.05:
            session.handle_timer(now)
        if rng.random() < 0.02:
            session.receive_close(rng.randrange(5000), "\x00gone", now)
    _check_last_words(session, session.messages_to_send(now))


def client_session(rng: random.Random, meter: Meter) -> None:
    """The client's end of a connection, in every state, while it speaks itself."""
    mutator = Mutator(rng, CORPUS)
    tracks = (FACE,) * rng.randrange(3)
    session = ClientSession(room="lobby", name="Ada", tracks=tracks, now=0.0)
    now = 0.0
    said: list[bytes] = []
    for data in shuffled(rng, to_client(rng, tracks) + [rng.choice(CORPUS) for _ in range(4)]):
        now += rng.choice((0.0, 0.0, 0.01, 1.0))
        before = session.state
        is_damaged = rng.random() < 0.2
        sent = mutator.mutate(data) if is_damaged else data
        events = meter.call(session.receive_data, sent, now)
        _note_session(session, meter, before, is_damaged=is_damaged)
        if before is State.CLOSED:
            expect(not events, "events after the end:", events)
            break
        expect(len(session.peers) <= MAX_PEERS, "more peers than a room holds:", session.peers)
        expect(len(session.away) <= MAX_PEERS, "more are away than were there:", session.away)
        if session.can_queue and tracks and rng.random() < 0.3:
            session.send_frame(rng.randbytes(30), captured_us=int(now * 1e6))
            session.tell(Subscribe(stream=3, every=2))
        if rng.random() < 0.03:
            session.leave(now)
        if rng.random() < 0.05:
            session.handle_timer(now)
        if rng.random() < 0.2:
            said += session.messages_to_send(now)
        expect(len(said) <= MAX_QUEUED_MESSAGES, "it talks too much")
    _check_last_words(session, said + session.messages_to_send(now))


def crowded_client(rng: random.Random, meter: Meter) -> None:
    """A client whose relay tells it of peers without end."""
    session = ClientSession(room="lobby", name="Ada", now=0.0)
    for data in to_client(rng, ())[:2]:
        session.receive_data(data, 0.0)
    for number in range(MAX_PEERS + 2):
        before = session.state
        meter.call(session.receive_data, encode_message(PeerAway(peer_id=f"y{number}")), 0.0)
        peer = Peer(peer_id=f"x{number}", name="X", tracks=(Track(kind="face", stream=number + 1),))
        meter.call(session.receive_data, encode_message(PeerJoined(peer=peer)), 0.0)
        _note_session(session, meter, before, is_damaged=False)
        many = max(len(session.peers), len(session.away))
        expect(many <= MAX_PEERS, "more peers than a room holds:", number)


def _note_session(
    session: ClientSession | ServerSession, meter: Meter, before: State, *, is_damaged: bool
) -> None:
    closed = session.closed
    outcome = "accepted" if closed is None or closed.is_remote else refusal(closed.code)
    meter.note(
        "ignored after the end" if before is State.CLOSED else outcome, is_damaged=is_damaged
    )


def _check_last_words(session: ClientSession | ServerSession, said: list[bytes]) -> None:
    """Check that what goes out can be read, and that a goodbye is the last of it."""
    messages = [decode_message(data) for data in said if data[0] == 1]
    for data in said:
        if data[0] == 2:
            decode_media(data)
    goodbyes = sum(isinstance(message, Bye) for message in messages)
    closed: Closed | None = session.closed
    if closed is not None and not closed.is_remote:
        expect(isinstance(messages[-1], Bye), "closed without a goodbye:", messages)
    expect(goodbyes <= 1, "two goodbyes:", messages)
    expect((session.state is State.CLOSED) == (closed is not None), "closed and not closed")
