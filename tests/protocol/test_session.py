from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.strategies import messages
from pica_protocol.client_session import MAX_QUEUED_MESSAGES, RIDE_S, ClientSession
from pica_protocol.codec import decode_message, encode_message
from pica_protocol.errors import CloseCode
from pica_protocol.frames import Frame, decode_media, encode_frame, media_message
from pica_protocol.limits import MAX_PEERS
from pica_protocol.messages import (
    Bye,
    Join,
    Joined,
    Message,
    Peer,
    PeerAway,
    PeerJoined,
    PeerLeft,
    PeerUpdated,
    StreamMuted,
    Subscribe,
    Track,
    UpdateMetadata,
    Whisper,
)
from pica_protocol.session import CLIENT_TABLE, SERVER_TABLE, Closed, Media, ServerSession, State

pytestmark = pytest.mark.unit

FACE = Track(kind="face")
VOICE = Track(kind="voice", deadline_ms=200)
OWN = Track(kind="face", stream=7)
BOB = Peer(peer_id="p2", name="Bob", tracks=(Track(kind="face", stream=8),))
JOINED = Joined(room="lobby", peer_id="p1", tracks=(OWN,), peers=(BOB,))


def sent(session: ClientSession | ServerSession) -> list[Message]:
    return [decode_message(data) for data in session.messages_to_send(now=0.0)]


def joined_client() -> ClientSession:
    client = ClientSession(room="lobby", name="Ada", tracks=(FACE,), now=0.0)
    client.messages_to_send(now=0.0)
    client.receive_data(encode_message(JOINED), now=0.2)
    return client


def joined_server() -> ServerSession:
    server = ServerSession(now=0.0)
    server.receive_data(encode_message(Join(room="lobby", name="Ada", tracks=(FACE,))), now=0.2)
    server.accept(JOINED)
    server.messages_to_send(now=0.2)
    return server


def test_frames_pass_from_client_to_server_unchanged() -> None:
    client, server = joined_client(), joined_server()
    client.send_frame(b"payload", captured_us=123)
    (message,) = client.messages_to_send(now=1.0)
    ((stream, _, start, end),) = server.receive_media(message)
    assert (stream, start, end) == (7, 1, len(message))
    expected = Frame(stream=7, sequence=0, captured_us=100, payload=b"payload")
    assert joined_client().receive_data(message, now=1.2) == [expected]


def test_a_payload_is_sealed_when_its_header_is_final() -> None:
    def seal(frame: Frame) -> bytes:
        return f"{frame.stream} {frame.sequence} ".encode() + frame.payload[::-1]

    client = ClientSession(room="lobby", name="Ada", tracks=(FACE,), now=0.0, seal=seal)
    client.receive_data(encode_message(JOINED), now=0.2)
    client.send_frame(b"one", captured_us=0)
    (media,) = client.messages_to_send(now=1.0)[-1:]
    assert [frame.payload for frame in decode_media(media)] == [b"7 0 eno"]


def test_sequences_count_per_track_and_wrap() -> None:
    client = joined_client()
    last = 0
    for _ in range(65_536 // 4 + 1):
        client.send_frame(b"", captured_us=0, multiple=4)
        (message,) = client.messages_to_send(now=1.0)
        last = int.from_bytes(message[3:5], "big")
    assert last == 0


def test_a_newer_frame_replaces_one_that_waits_and_one_for_everybody_has_a_multiple_of_four() -> (
    None
):
    client = joined_client()
    client.send_frame(b"old", captured_us=1)
    client.send_frame(b"new", captured_us=2)
    (message,) = client.messages_to_send(now=1.0)
    assert message.endswith(b"new")
    assert b"old" not in message
    assert client.drops == {"replaced": 1}
    client.send_frame(b"newer", captured_us=3)
    client.send_frame(b"newest", captured_us=4, multiple=4)
    (later,) = client.messages_to_send(now=1.0)
    # What was never sent leaves no hole: it would look like a loss on the way.
    assert [frame.sequence for each in (message, later) for frame in decode_media(each)] == [0, 4]


def test_what_waits_is_split_into_messages_that_the_relay_takes() -> None:
    data = Track(kind="data", deadline_ms=100)
    client = ClientSession(room="lobby", name="Ada", tracks=(data,) * 4, now=0.0)
    own = tuple(replace(data, stream=stream) for stream in (7, 9, 10, 11))
    client.receive_data(encode_message(Joined(room="lobby", peer_id="p1", tracks=own)), now=0.2)
    client.messages_to_send(now=0.0)
    for track in range(4):
        for _ in range(5):
            client.send_frame(bytes(1192), 0, track=track)
    messages = client.messages_to_send(now=0.0)
    assert [len(decode_media(message)) for message in messages] == [13, 7]


@pytest.mark.parametrize("elapsed_s", [0.03, 100.0, 209.8, 5000.0])
def test_capture_times_are_whole_again_however_long_nothing_came(elapsed_s: float) -> None:
    client = joined_client()
    peer = Peer(peer_id="p77", name="Cyd", tracks=(Track(kind="face", stream=28),))
    client.receive_data(encode_message(PeerJoined(peer=peer)), now=1.0)
    captured_us = [7_000_000, 7_000_000 + round(elapsed_s * 1e6)]
    frames = [Frame(stream=28, sequence=0, captured_us=us, payload=b"") for us in captured_us]
    times = []
    for frame, now in zip(frames, (1.0, 1.2 + elapsed_s), strict=True):
        (got,) = client.receive_data(media_message([encode_frame(frame)]), now=now)
        assert isinstance(got, Frame)
        times.append(got.captured_us)
    assert times[1] - times[0] == captured_us[1] - captured_us[0]


def test_a_goodbye_ends_both_sides() -> None:
    client, server = joined_client(), joined_server()
    client.close()
    (bye,) = client.messages_to_send(now=5.0)
    assert server.receive_data(bye, now=5.1) == [Closed(code=1000, reason="left", is_remote=True)]
    assert server.messages_to_send(now=5.1) == []


def test_a_client_gives_up_on_a_silent_relay_at_the_deadline() -> None:
    client = ClientSession(room="lobby", name="Ada", now=10.0, timeout_s=5.0)
    assert client.next_timer() == 15.0
    assert client.handle_timer(now=14.999) == []
    (closed,) = client.handle_timer(now=15.0)
    assert closed == client.closed
    assert closed.code == CloseCode.HANDSHAKE_TIMEOUT  # type: ignore[union-attr]
    assert client.next_timer() is None


def test_nothing_is_said_before_the_join_and_no_more_than_waits_to_be_sent() -> None:
    client = ClientSession(room="lobby", name="Ada", tracks=(FACE,), now=0.0)
    assert not client.send_frame(b"", captured_us=0)
    assert not client.tell(Subscribe(stream=8))
    client = joined_client()
    told = [client.tell(Subscribe(stream=8)) for _ in range(MAX_QUEUED_MESSAGES + 1)]
    assert told == [True] * MAX_QUEUED_MESSAGES + [False]


def test_a_long_reason_is_clipped_to_what_a_close_frame_holds() -> None:
    server = ServerSession(now=0.0)
    server.close(CloseCode.MALFORMED, "é" * 100 + "\n")
    (bye,) = sent(server)
    assert isinstance(bye, Bye)
    assert bye.reason == "é" * 60


SAMPLES: list[Message] = [
    Join(room="lobby", name="Ada", tracks=(FACE,)),
    JOINED,
    PeerJoined(peer=BOB),
    PeerLeft(peer_id="p2"),
    Subscribe(stream=8),
    Whisper(peer_id="p2", data=b"x"),
    PeerAway(peer_id="p2", is_away=True),
    PeerAway(peer_id="p2", is_away=False),
    PeerUpdated(peer_id="p2"),
    StreamMuted(stream=8, is_muted=True),
    UpdateMetadata(),
]
FRAME = media_message([encode_frame(Frame(stream=8, sequence=0, captured_us=0, payload=b""))])


def session_in(state: State, *, is_client: bool) -> ClientSession | ServerSession:
    session: ClientSession | ServerSession
    if is_client:
        session = ClientSession(room="lobby", name="Ada", tracks=(FACE,), now=0.0)
        steps: list[tuple[State, Message]] = [(State.JOINED, JOINED)]
    else:
        session = ServerSession(now=0.0)
        steps = [(State.DECIDING, SAMPLES[0])]
    for reached, message in steps:
        if session.state is not state:
            session.receive_data(encode_message(message), now=0.0)
            assert session.state is reached
    if isinstance(session, ServerSession) and state is State.JOINED:
        session.accept(JOINED)
    if state is State.CLOSED:
        session.close(1000, "")
    assert session.state is state
    session.messages_to_send(now=0.0)
    return session


@pytest.mark.parametrize("is_client", [True, False], ids=["client", "server"])
def test_what_the_table_does_not_allow_is_an_unexpected_message(is_client: bool) -> None:
    table = CLIENT_TABLE if is_client else SERVER_TABLE
    received = {type(message): encode_message(message) for message in SAMPLES}
    for state in set(table) - {State.CLOSED}:
        for kind, data in {**received, Media: FRAME}.items():
            session = session_in(state, is_client=is_client)
            session.receive_data(data, now=0.0)
            reached = table[state].get(kind)
            if reached is None:
                assert session.closed is not None
                assert session.closed.code == CloseCode.UNEXPECTED_MESSAGE, (state, kind)
            else:
                assert session.state is reached, (state, kind)


@given(
    is_client=st.booleans(),
    data=st.lists(st.binary(max_size=50) | messages.map(encode_message) | st.just(FRAME)),
    state=st.sampled_from([State.JOINING, State.JOINED]),
)
def test_no_received_bytes_make_a_session_raise_or_speak_after_its_goodbye(
    is_client: bool, data: list[bytes], state: State
) -> None:
    session = session_in(state, is_client=is_client)
    for item in data:
        session.receive_data(item, now=0.0)
        if isinstance(session, ServerSession) and session.state is State.DECIDING:
            session.accept(JOINED)
    said = sent(session)
    if session.closed is not None and not session.closed.is_remote:
        assert isinstance(said[-1], Bye)
    assert sum(isinstance(message, Bye) for message in said) <= 1


def test_a_client_does_not_believe_in_more_peers_than_a_room_holds() -> None:
    client = joined_client()
    for number in range(MAX_PEERS + 1):
        peer = Peer(peer_id=f"x{number}", name="X")
        client.receive_data(encode_message(PeerJoined(peer=peer)), now=1.0)
    assert len(client.peers) == MAX_PEERS
    assert client.closed is not None
    assert client.closed.code == CloseCode.MALFORMED


def test_a_face_of_ours_rides_with_our_voice_and_alone_only_when_none_comes() -> None:
    session = ClientSession(room="lobby", name="Ada", tracks=(FACE, VOICE), now=0.0)
    session.messages_to_send(0.0)
    own = (replace(FACE, stream=1), replace(VOICE, stream=2))
    session.receive_data(encode_message(Joined(room="lobby", peer_id="p1", tracks=own)), 0.0)

    def streams(now: float) -> list[list[int]]:
        return [[f.stream for f in decode_media(m)] for m in session.messages_to_send(now)]

    session.send_frame(b"face", 1_000_000)
    assert streams(1.0) == [[1]]  # nobody speaks
    session.send_frame(b"voice", 1_010_000, track=1)
    assert streams(1.01) == [[2]]
    session.send_frame(b"face", 1_020_000)
    assert streams(1.02) == []
    assert session.frames_due_s == 1.01 + RIDE_S
    session.send_frame(b"voice", 1_050_000, track=1)
    assert streams(1.05) == [[2, 1]]
    session.send_frame(b"face", 1_060_000)
    assert streams(1.05 + RIDE_S) == [[1]]


@pytest.mark.parametrize(
    ("joined", "reason"),
    [
        (replace(JOINED, tracks=()), "joined with other tracks than ours"),
        (replace(JOINED, resumed=True), "resumed, and we did not ask to"),
        (replace(JOINED, room="attic"), "room attic, not the one asked for"),
        (replace(JOINED, peers=(replace(BOB, peer_id="p1"),)), "a room that has a peer twice"),
        (replace(JOINED, peers=(BOB, BOB)), "a room that has a peer twice"),
        (replace(JOINED, peers=(replace(BOB, tracks=(OWN,)),)), "a room that has a stream twice"),
    ],
    ids=["other tracks", "resumed", "another room", "ourselves", "twice", "our own stream"],
)
def test_a_client_does_not_join_a_room_that_cannot_be(joined: Joined, reason: str) -> None:
    client = ClientSession(room="lobby", name="Ada", tracks=(FACE,), now=0.0)
    (closed,) = client.receive_data(encode_message(joined), 0.1)
    assert isinstance(closed, Closed)
    assert reason in closed.reason


def test_a_newcomer_has_an_id_and_streams_of_its_own() -> None:
    for newcomer in (
        Peer(peer_id="p1", name="Ada"),
        Peer(peer_id="p9", name="Eve", tracks=(OWN,)),
        Peer(peer_id="p9", name="Eve", tracks=BOB.tracks),
    ):
        client = joined_client()
        (closed,) = client.receive_data(encode_message(PeerJoined(peer=newcomer)), 1.0)
        assert isinstance(closed, Closed)
        assert "twice" in closed.reason


def test_who_comes_under_the_id_of_somebody_who_is_here_takes_their_place() -> None:
    client, eve = joined_client(), replace(BOB, name="Eve")
    events = client.receive_data(encode_message(PeerJoined(peer=eve)), 1.0)
    assert events == [PeerLeft(peer_id=BOB.peer_id), PeerJoined(peer=eve)]
    assert client.peers == {BOB.peer_id: eve}


def client_with(former: ClientSession | None = None, *, resumed: bool = False) -> ClientSession:
    client = ClientSession(room="r", name="Ada", tracks=(FACE,), now=0.0, former=former)
    own = (replace(FACE, stream=1),)
    joined = Joined(room="r", peer_id="p1", tracks=own, resume="s3cret", resumed=resumed)
    client.receive_data(encode_message(joined), now=0.0)
    return client


@pytest.mark.parametrize(("resumed", "sequence"), [(True, 3), (False, 0)])
def test_a_client_that_comes_back_to_its_place_goes_on_counting_where_it_stopped(
    resumed: bool, sequence: int
) -> None:
    client = client_with()
    for _ in range(3):
        client.send_frame(b"x", captured_us=0)
        client.messages_to_send(now=0.0)
    again = client_with(client, resumed=resumed)
    (join,) = sent(again)
    assert isinstance(join, Join)
    assert join.resume == "s3cret"
    again.send_frame(b"x", captured_us=0)
    assert decode_media(again.messages_to_send(now=0.0)[0])[0].sequence == sequence


def test_tokens_and_secrets_to_come_back_with_are_not_shown_when_printed() -> None:
    shown = repr(client_with()) + repr(Joined(room="r", peer_id="p", resume="s3cret"))
    assert "s3cret" not in shown + repr(Join(room="r", name="n", token="s3cret", resume="s3cret"))


def test_frames_of_a_muted_stream_stay_here_and_leave_a_hole_in_the_sequence() -> None:
    client = client_with()
    client.messages_to_send(now=0.0)
    sent: list[int] = []
    for is_muted in (False, True, False):
        client.receive_data(encode_message(StreamMuted(stream=1, is_muted=is_muted)), now=0.0)
        client.send_frame(b"x", captured_us=0)
        for message in client.messages_to_send(now=0.0):
            sent += [frame.sequence for frame in decode_media(message)]
    assert sent == [0, 2]
    assert client.drops == {"muted": 1}
