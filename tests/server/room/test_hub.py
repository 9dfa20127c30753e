"""The whole relay with literal times and no socket."""

import pytest

from helpers.members import Member, hub_with
from pica_protocol.client_session import ClientSession
from pica_protocol.codec import encode_message
from pica_protocol.errors import CloseCode
from pica_protocol.frames import Frame, encode_frame, media_message
from pica_protocol.messages import Bye, Join, Joined, PeerJoined, PeerLeft, Subscribe, Whisper
from pica_server.config import LimitsConfig, RelayConfig
from pica_server.limits import RefusalError
from pica_server.room.connections import CALM_S, LATE_S, Overload
from pica_server.room.hub import Hub
from pica_server.room.membership import OWN_JOINS_BURST
from pica_server.room.outbox import MAX_CONTROL_BYTES
from pica_server.tokens import Admission

pytestmark = pytest.mark.unit


def test_forwarding_latency_runs_from_receipt_to_the_socket() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob")
    ada.send_frame(b"x", now=1.0)
    bob.listen(now=1.009)
    assert hub.stats.forwarding.sum_s == pytest.approx(0.009)


def test_every_frame_is_delivered_or_counted_as_dropped() -> None:
    hub, (ada, bob, cyd) = hub_with("Ada", "Bob", "Cyd")
    for i in range(10):
        ada.send_frame(bytes([i]), now=1.0 + i)
        bob.listen(now=1.0 + i)
    hub.disconnect(cyd.connection, 1006, "", now=20.0)
    stats = hub.stats
    assert stats.frames_in == 10
    assert stats.frames_out == 10
    assert stats.dropped == {"departed": 10}


def test_a_foreign_stream_closes_its_sender_and_forwards_none_of_it() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob")
    own = b"\x00\x01" + bytes(6)
    bobs = b"\x00\x02" + bytes(6)
    hub.receive(ada.connection, [b"\x02" + bobs + own], now=1.0)
    assert ada.closed_code == CloseCode.FOREIGN_STREAM
    assert bob.listen(now=1.0) == [PeerLeft(peer_id=ada.session.peer_id, reason="removed")]


def test_a_peer_that_lets_control_pile_up_is_closed_and_the_rest_is_told() -> None:
    limits = LimitsConfig(joins_burst=10_000)
    config = RelayConfig(room_capacity=64, limits=limits)
    hub, (ada, bob) = hub_with("Ada", "Bob", config=config)
    long = tuple((f"{i}", "x" * 64) for i in range(8))
    for i in range(500):  # people come and go; Bob does not read
        guest = Member(hub, f"Guest {i}", now=1.0, metadata=long)
        hub.disconnect(guest.connection, 1006, "", now=1.0)
        ada.listen(now=1.0)
        assert bob.connection.outbox.waiting_control_bytes <= MAX_CONTROL_BYTES + 200
    assert bob.closed_code == CloseCode.TOO_SLOW
    assert bob.session.peer_id not in ada.session.peers
    heard = bob.listen(now=2.0)
    assert isinstance(heard[-1], Bye)  # and what had piled up before it, in order
    assert sum(isinstance(message, PeerJoined) for message in heard) > 100


def test_a_handshake_is_late_at_its_deadline() -> None:
    hub = Hub(RelayConfig(handshake_timeout_s=5))
    connection = hub.connect(now=10.0)
    hub.handle_timer(now=14.9)
    assert connection.closed is None
    hub.handle_timer(now=15.0)
    assert connection.closed is not None
    assert connection.closed.code == CloseCode.HANDSHAKE_TIMEOUT
    assert hub.num_connections == 0


def test_a_peer_that_merely_has_nothing_to_read_is_not_late() -> None:
    hub, (ada, _) = hub_with("Ada", "Bob")
    for second in range(100):
        hub.handle_timer(float(second))
    assert ada.closed_code is None


def hub_of_limits(**limits: float) -> Hub:
    return Hub(RelayConfig(limits=LimitsConfig(**limits)))  # type: ignore[arg-type]


def test_a_publisher_above_its_rate_is_closed_and_one_below_it_is_not() -> None:
    hub = hub_of_limits(bytes_per_s=60 * 530, burst_s=1)
    ada, flood = Member(hub, "Ada"), Member(hub, "Flood")
    for i in range(300):
        ada.send_frame(b"x", now=i / 30)
        if flood.closed_code is None:
            flood.send_frame(b"x", now=i / 300)
    assert ada.closed_code is None
    assert flood.closed_code == CloseCode.TOO_FAST
    assert hub.stats.limits_hit == {"bytes": 1}


def test_what_piled_up_on_the_way_is_no_flood_and_who_has_just_come_saved_nothing_up() -> None:
    hub = hub_of_limits(bytes_per_s=60 * 530, burst_s=10)
    ada, new = Member(hub, "Ada"), Member(hub, "New", now=20.0)
    for i in range(300):  # of ten seconds
        ada.send_frame(b"x", now=20.0 + i / 1e5)
        if new.closed_code is None:
            new.send_frame(b"x", now=20.0 + i / 1e5)
    assert ada.closed_code is None
    assert new.closed_code == CloseCode.TOO_FAST


def test_frames_are_counted_one_by_one_however_many_share_a_message() -> None:
    hub = hub_of_limits(bytes_per_s=5250, burst_s=1)
    ada = Member(hub, "Ada")
    frame = b"\x00\x01" + bytes(6)
    hub.receive(ada.connection, [b"\x02" + frame * 9], now=1.0)
    assert ada.closed_code is None
    hub.receive(ada.connection, [b"\x02" + frame * 3], now=1.1)
    assert ada.closed_code == CloseCode.TOO_FAST
    assert hub.stats.frames_in == 9


def test_more_joins_than_the_relay_takes_are_told_to_come_later() -> None:
    hub = hub_of_limits(joins_per_s=1, joins_burst=3)
    guests = [Member(hub, f"Guest {i}", now=1.0) for i in range(5)]
    assert [guest.closed_code for guest in guests] == [None] * 3 + [CloseCode.BUSY] * 2
    assert Member(hub, "Later", now=2.0).closed_code is None
    assert hub.stats.limits_hit == {"joins": 2}


def test_who_may_not_join_does_not_use_up_the_joins_of_those_who_may() -> None:
    def admit(join: Join) -> Admission:
        if join.name != "Ada":
            raise RefusalError("no", CloseCode.UNAUTHORIZED)
        return Admission()

    limits = LimitsConfig(joins_per_s=1, joins_burst=1)
    hub = Hub(RelayConfig(limits=limits), admit)
    strangers = [Member(hub, f"Stranger {i}") for i in range(5)]
    assert {stranger.closed_code for stranger in strangers} == {CloseCode.UNAUTHORIZED}
    assert Member(hub, "Ada").closed_code is None


def test_one_identity_does_not_use_up_the_joins_of_the_others() -> None:
    limits = LimitsConfig(joins_per_s=1, joins_burst=int(OWN_JOINS_BURST) + 1)
    hub = Hub(
        RelayConfig(limits=limits),
        lambda join: Admission(identity=join.name),
        new_secret=lambda: "t",
    )
    greedy = [Member(hub, "Eve") for _ in range(30)]
    assert [each.closed_code for each in greedy].count(CloseCode.BUSY) == 20
    ada = Member(hub, "Ada", resumable=True)
    assert ada.closed_code is None
    assert Member(hub, "Ben").closed_code == CloseCode.BUSY
    back = Member(hub, "Ada", resumable=True, former=ada.session)
    assert back.closed_code is None
    assert back.peer_id == ada.peer_id


def test_one_address_has_a_limit_of_its_own_and_gets_its_places_back() -> None:
    hub = hub_of_limits(connections_per_address=2)
    members = [Member(hub, f"m{i}", address="192.0.2.1") for i in range(3)]
    assert [member.closed_code for member in members] == [None, None, CloseCode.TOO_MANY]
    assert Member(hub, "other", address="192.0.2.2").closed_code is None
    assert Member(hub, "here").closed_code is None
    hub.disconnect(members[0].connection, 1006, "", now=1.0)
    assert Member(hub, "next", address="192.0.2.1").closed_code is None


def test_a_ghost_does_not_keep_who_comes_back_out_of_a_crowded_address() -> None:
    config = RelayConfig(limits=LimitsConfig(connections_per_address=1))
    hub, _ = hub_with(config=config)
    ghost = Member(hub, "Ada", address="192.0.2.1", resumable=True)
    guess = ClientSession(room="lobby", name="Eve", now=0.0)
    joined = Joined(room="lobby", peer_id="p9", resume="guess")
    guess.receive_data(encode_message(joined), now=0.0)
    stranger = Member(hub, "Eve", address="192.0.2.1", now=1.0, resumable=True, former=guess)
    assert stranger.closed_code == CloseCode.TOO_MANY
    former = ghost.session
    back = Member(hub, "Ada", address="192.0.2.1", now=2.0, resumable=True, former=former)
    assert back.closed_code is None
    assert back.peer_id == ghost.peer_id
    assert ghost.closed_code == CloseCode.REPLACED
    assert hub.stats.limits_hit == {"address": 1}
    assert Member(hub, "third", address="192.0.2.1").closed_code == CloseCode.TOO_MANY


def test_a_whisper_reaches_one_peer_under_its_senders_name() -> None:
    hub, (ada, bob, cyd) = hub_with("Ada", "Bob", "Cyd")
    ada.session.tell(Whisper(peer_id=bob.session.peer_id, data=b"key"))
    ada.speak(now=1.0)
    assert bob.listen(now=1.0) == [Whisper(peer_id=ada.session.peer_id, data=b"key")]
    assert ada.listen(now=1.0) == cyd.listen(now=1.0) == []
    assert hub.stats.whispers == 1


def test_a_whisper_stays_in_its_room() -> None:
    hub, (ada, away) = hub_with("Ada", "Bob", resumable=True)
    eve = Member(hub, "Eve", room="elsewhere")
    away.lose_connection(now=0.5)
    ada.listen(now=0.5)
    for receiver in (eve.peer_id, ada.peer_id, away.peer_id, "p99"):
        ada.session.tell(Whisper(peer_id=receiver, data=b"key"))
    ada.speak(now=1.0)
    assert eve.listen(now=1.0) == ada.listen(now=1.0) == []
    assert hub.stats.whispers_dropped == {"absent": 4}


def test_who_whispers_too_much_is_not_heard_for_a_while() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob")
    heard = []
    for now in (1.0, 1.5, 100.0):
        heard.append(0)
        for _ in range(200):
            ada.session.tell(Whisper(peer_id=bob.session.peer_id, data=b"x"))
            ada.speak(now)
            heard[-1] += len(bob.listen(now))
    assert heard == [128, 8, 128]
    assert hub.stats.whispers_dropped == {"rate": 600 - 264}
    assert ada.closed_code is None


def test_whispers_do_not_get_a_slow_reader_closed() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob")
    for second in range(60):
        for _ in range(100):
            ada.session.tell(Whisper(peer_id=bob.session.peer_id, data=bytes(512)))
        ada.speak(now=float(second))
    assert bob.closed_code is None
    assert bob.connection.outbox.waiting_control_bytes == 0
    assert (
        bob.connection.outbox.waiting_frames == hub.stats.whispers - hub.stats.dropped["overflow"]
    )


def test_who_wants_a_stream_again_or_comes_late_gets_its_newest_face() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob")
    for every, heard in ((0, []), (1, [b"newest"])):
        bob.session.tell(Subscribe(stream=ada.stream, every=every))
        bob.speak(now=1.0)
        for payload in () if every else (b"older", b"newest"):
            ada.send_frame(payload, now=1.0)
        assert [each.payload for each in bob.listen(1.0) if isinstance(each, Frame)] == heard
    late = Member(hub, "Late", now=2.0)
    assert [each.payload for each in late.heard if isinstance(each, Frame)] == [b"newest"]


def test_close_codes_that_peers_make_up_are_counted_together() -> None:
    hub, members = hub_with("Ada", "Bob", "Cyd")
    for member, code in zip(members, (3001, 4444, 1000), strict=True):
        hub.receive(member.connection, [encode_message(Bye(code=code))], now=1.0)
    assert hub.stats.closed == {0: 2, 1000: 1}


# More to do than it can


def test_one_late_turn_sheds_and_two_in_a_row_refuse_newcomers_for_a_while() -> None:
    overload = Overload()
    overload.note_turn(LATE_S, now=1.0)
    assert overload.sheds
    assert not overload.refuses(1.0)
    overload.note_turn(LATE_S, now=1.1)
    assert overload.refuses(1.1)
    overload.note_turn(0.0, now=1.2)
    assert not overload.sheds
    assert not overload.refuses(1.1 + CALM_S)


def test_of_faces_that_came_together_a_late_relay_passes_on_the_newest_of_each_stream() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob")

    def face(sequence: int) -> bytes:
        frame = Frame(stream=ada.stream, sequence=sequence, captured_us=0, payload=b"face")
        return media_message([encode_frame(frame)])

    hub.overload.note_turn(LATE_S, now=1.0)
    hub.receive(ada.connection, [face(0), face(1), face(2)], 1.0)
    assert [frame.sequence for frame in bob.listen(1.0) if isinstance(frame, Frame)] == [2]
    assert hub.stats.dropped == {"late": 2}


def test_a_relay_that_others_keep_from_the_processor_lets_newcomers_in() -> None:
    overload = Overload()
    for number in range(4):
        overload.note_turn(LATE_S, now=1.0 + number, worked=0.2)
    assert overload.sheds
    assert not overload.refuses(4.0)
