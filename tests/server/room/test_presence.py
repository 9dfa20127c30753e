"""Who is away, who comes back, what peers say of themselves: the hub with literal times."""

from dataclasses import replace

import pytest

from helpers.members import FACE, VOICE, Member, counting_secrets, hub_with
from pica_protocol.client_session import ClientSession
from pica_protocol.errors import CloseCode
from pica_protocol.frames import Frame
from pica_protocol.messages import (
    Bye,
    Joined,
    Message,
    PeerAway,
    PeerJoined,
    PeerLeft,
    PeerUpdated,
    UpdateMetadata,
)
from pica_protocol.session import State
from pica_server.config import RelayConfig
from pica_server.room.hub import Hub
from pica_server.tokens import Admission

pytestmark = pytest.mark.unit


def come_back(hub: Hub, former: ClientSession, now: float, name: str = "Ada") -> Member:
    assert former.is_resumable
    member = Member(hub, name, now=now, resumable=True, former=former)
    member.heard += member.listen(now)
    return member


def joined_of(member: Member) -> Joined:
    return next(each for each in member.heard if isinstance(each, Joined))


def control(heard: list[Message | Frame]) -> list[Message]:
    return [each for each in heard if not isinstance(each, Frame)]


def test_who_comes_back_in_time_has_its_old_id_and_streams_and_nobody_saw_it_leave() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob", resumable=True)
    former = ada.lose_connection(now=1.0)
    assert bob.listen(now=1.0) == [PeerAway(peer_id=ada.peer_id, is_away=True)]
    again = come_back(hub, former, now=10.9)
    assert (again.peer_id, again.stream) == (ada.peer_id, ada.stream)
    assert joined_of(again).resumed
    assert list(again.session.peers) == [bob.peer_id]
    assert bob.listen(now=10.9) == [PeerAway(peer_id=ada.peer_id, is_away=False)]
    assert hub.stats.resumes == {"away": 1, "resumed": 1}
    hub.handle_timer(now=30.0)
    assert bob.listen(now=30.0) == []


def test_who_crashed_and_begins_anew_does_not_stand_beside_their_old_face() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob", resumable=True)
    ada.lose_connection(now=1.0)
    other = Member(hub, "Ada", now=1.4, tracks=(FACE, VOICE))
    assert {p.name for p in other.session.peers.values()} == {"Ada", "Bob"}
    again = Member(hub, "Ada", now=1.5)
    assert {p.peer_id for p in again.session.peers.values()} == {other.peer_id, bob.peer_id}
    assert ada.peer_id in {e.peer_id for e in bob.listen(now=1.5) if isinstance(e, PeerLeft)}
    third = Member(hub, "Ada", now=1.6)  # nobody is away now: another person of that name
    assert again.peer_id in third.session.peers


def test_who_does_not_come_back_has_left_when_the_grace_is_over() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob", resumable=True)
    former = ada.lose_connection(now=1.0)
    bob.listen(now=1.0)
    hub.handle_timer(10.9)
    assert bob.listen(10.9) == []
    hub.handle_timer(11.0)
    assert bob.listen(11.0) == [PeerLeft(peer_id=ada.peer_id, reason="lost")]
    assert bob.session.peers == {}
    again = come_back(hub, former, now=11.1)
    assert not joined_of(again).resumed
    assert again.peer_id != ada.peer_id
    assert hub.stats.resumes == {"away": 1, "unknown": 1}


def test_a_secret_is_good_once_and_another_one_comes_with_each_return() -> None:
    hub, (ada, _bob) = hub_with("Ada", "Bob", resumable=True)
    first = ada.lose_connection(now=1.0)
    again = come_back(hub, first, now=2.0)
    second = again.lose_connection(now=3.0)
    thief = come_back(hub, first, now=4.0)
    assert thief.peer_id != ada.peer_id
    assert come_back(hub, second, now=5.0).peer_id == ada.peer_id


def test_whoever_comes_back_before_the_relay_has_noticed_takes_the_place_over() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob", resumable=True)
    again = come_back(hub, ada.session, now=5.0)
    assert again.peer_id == ada.peer_id
    assert ada.closed_code == CloseCode.REPLACED
    assert isinstance(ada.listen(now=5.0)[-1], Bye)
    assert bob.listen(now=5.0) == [PeerAway(peer_id=ada.peer_id, is_away=False)]
    hub.disconnect(ada.connection, 1006, "", now=6.0)
    again.send_frame(b"x", now=6.0)
    assert [each.payload for each in bob.listen(now=6.0) if isinstance(each, Frame)] == [b"x"]
    assert hub.num_connections == 2


def test_who_goes_on_purpose_or_breaks_the_protocol_is_gone_at_once() -> None:
    hub, (ada, bob, cyd) = hub_with("Ada", "Bob", "Cyd", resumable=True)
    ada.session.close()
    ada.speak(now=1.0)
    hub.receive(bob.connection, [b"\x03"], now=1.0)
    assert control(cyd.listen(now=1.0)) == [
        PeerLeft(peer_id=ada.peer_id, reason="left"),
        PeerLeft(peer_id=bob.peer_id, reason="removed"),
    ]
    for former in (ada, bob):
        assert come_back(hub, former.session, now=2.0).peer_id != former.peer_id


def test_a_place_that_is_kept_for_an_identity_counts_for_the_capacity() -> None:
    hub = hub_of_identities(RelayConfig(room_capacity=2))
    ada = Member(hub, "Ada", token="ada", resumable=True)
    Member(hub, "Bob", token="bob", resumable=True)
    former = ada.lose_connection(now=1.0)
    assert Member(hub, "Cyd", token="cyd", now=2.0).closed_code == CloseCode.ROOM_FULL
    again = Member(hub, "Ada", token="ada", now=3.0, resumable=True, former=former)
    assert again.peer_id == ada.peer_id


def test_a_newcomer_learns_who_is_away() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob", resumable=True)
    ada.lose_connection(now=1.0)
    cyd = Member(hub, "Cyd", now=2.0)
    assert set(cyd.session.peers) == {ada.peer_id, bob.peer_id}
    assert PeerAway(peer_id=ada.peer_id, is_away=True) in cyd.heard


def test_nobody_comes_back_into_another_room_or_with_other_tracks() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob", resumable=True)
    former = ada.lose_connection(now=1.0)
    bob.listen(now=1.0)
    elsewhere = Member(hub, "Ada", room="elsewhere", now=2.0, former=former, resumable=True)
    assert elsewhere.peer_id != ada.peer_id
    other = Member(
        hub, "Ada", now=3.0, former=former, resumable=True, tracks=(replace(FACE, kind="mask"),)
    )
    assert other.peer_id != ada.peer_id
    assert [type(each) for each in bob.listen(now=3.0)] == [PeerLeft, PeerJoined]
    assert come_back(hub, former, now=4.0).peer_id != ada.peer_id
    assert hub.stats.resumes == {"away": 1, "unknown": 2, "unfit": 1}


def hub_of_identities(config: RelayConfig | None = None) -> Hub:
    """Tokens are the identities themselves."""
    return Hub(
        config or RelayConfig(),
        lambda join: Admission(identity=join.token),
        new_secret=counting_secrets(),
    )


@pytest.mark.parametrize(("token", "has_secret"), [("ada", False), ("mallory", True)])
def test_a_stolen_identity_without_the_secret_and_the_reverse_give_no_place(
    token: str, has_secret: bool
) -> None:
    hub = hub_of_identities()
    ada = Member(hub, "Ada", token="ada", resumable=True)
    lost = ada.lose_connection(now=1.0)
    former = lost if has_secret else None
    thief = Member(hub, "Ada", token=token, resumable=True, now=2.0, former=former)
    assert thief.peer_id != ada.peer_id
    assert not joined_of(thief).resumed


@pytest.mark.parametrize("is_lost", [True, False])
def test_who_comes_with_a_stolen_secret_takes_no_place_from_its_owner(is_lost: bool) -> None:
    hub = hub_of_identities()
    ada, bob = (Member(hub, each, token=each, resumable=True) for each in ("ada", "bob"))
    if is_lost:
        ada.lose_connection(now=1.0)
    bob.listen(now=1.0)
    Member(hub, "ada", token="mallory", now=2.0, former=ada.session)
    assert [type(each) for each in bob.listen(now=2.0)] == [PeerJoined]
    assert ada.closed_code is None or is_lost
    again = Member(hub, "ada", token="ada", resumable=True, now=3.0, former=ada.session)
    assert (again.peer_id, joined_of(again).resumed) == (ada.peer_id, True)


def test_of_two_with_one_identity_the_newer_stays_and_the_older_is_told() -> None:
    hub = hub_of_identities()
    old = Member(hub, "Ada", token="ada")
    bob = Member(hub, "Bob", token="bob")
    bob.listen(now=0.0)
    new = Member(hub, "Ada", token="ada", now=1.0)
    assert old.closed_code == CloseCode.REPLACED
    assert old.listen(now=1.0)[-1] == Bye(code=4013, reason="you have joined again from elsewhere")
    heard = bob.listen(now=1.0)
    assert heard[0] == PeerLeft(peer_id=old.peer_id, reason="removed")
    assert isinstance(heard[1], PeerJoined)
    assert new.session.state is State.JOINED
    assert Member(hub, "Ada", token="ada", room="elsewhere").closed_code is None
    assert new.closed_code is None


def test_the_others_learn_who_somebody_is_and_whether_their_name_is_assured() -> None:
    hub = Hub(RelayConfig(), lambda join: Admission(identity=join.token, name=join.token[3:]))
    bob = Member(hub, "Bob", token="b-1")
    ada = Member(hub, "Mallory", token="a-1Ada")
    (arrival,) = bob.listen(now=0.0)
    assert isinstance(arrival, PeerJoined)
    seen = arrival.peer
    assert (seen.name, seen.identity, seen.is_name_assured) == ("Ada", "a-1Ada", True)
    assert (ada.session.name, bob.session.name) == ("Ada", "Bob")
    (seen,) = ada.session.peers.values()
    assert (seen.name, seen.identity, seen.is_name_assured) == ("Bob", "b-1", False)


def test_nobody_is_kept_while_a_relay_drains() -> None:
    hub, (ada, _bob) = hub_with("Ada", "Bob", resumable=True)
    ada.lose_connection(now=1.0)
    hub.drain(now=2.0)
    assert (hub.num_connections, hub.num_rooms) == (0, 0)


def test_what_a_peer_says_of_itself_reaches_the_others_and_those_who_come_later() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob")
    for metadata in ((("hand", "up"),), (("hand", "up"),), (("hand", "down"),)):
        ada.session.tell(UpdateMetadata(metadata=metadata))
        ada.speak(now=1.0)
    assert bob.listen(now=1.0) == [
        PeerUpdated(peer_id=ada.peer_id, metadata=(("hand", "up"),)),
        PeerUpdated(peer_id=ada.peer_id, metadata=(("hand", "down"),)),
    ]
    assert bob.session.peers[ada.peer_id].metadata == (("hand", "down"),)
    assert ada.listen(now=1.0) == []
    cyd = Member(hub, "Cyd", now=2.0, metadata=(("role", "guest"),))
    assert cyd.session.peers[ada.peer_id].metadata == (("hand", "down"),)
    (arrival,) = bob.listen(now=2.0)
    assert isinstance(arrival, PeerJoined)
    assert arrival.peer.metadata == (("role", "guest"),)


def test_what_a_peer_says_when_it_comes_back_is_news_only_if_it_has_changed() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob", resumable=True)
    again = come_back(hub, ada.lose_connection(now=1.0), now=2.0)
    assert [type(each) for each in bob.listen(now=2.0)] == [PeerAway] * 2
    former = again.lose_connection(now=3.0)
    Member(hub, "Ada", now=4.0, former=former, metadata=(("hand", "up"),))
    assert [type(each) for each in bob.listen(now=4.0)] == [PeerAway, PeerAway, PeerUpdated]


def test_who_changes_what_it_says_too_often_is_closed() -> None:
    _hub, (ada, bob) = hub_with("Ada", "Bob")
    for i in range(60):
        if ada.session.state is State.JOINED:
            ada.session.tell(UpdateMetadata(metadata=(("n", str(i)),)))
            ada.speak(now=1.0)
            ada.listen(now=1.0)
    assert ada.closed_code == CloseCode.TOO_FAST
    assert sum(isinstance(each, PeerUpdated) for each in bob.listen(now=1.0)) == 10


def test_a_slow_reader_that_was_closed_may_come_back_to_its_place() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob", resumable=True)
    ada.send_frame(b"x", now=100.0)
    assert hub.take(bob.connection, now=100.0) is not None  # and never sent
    hub.handle_timer(now=110.0)
    assert bob.closed_code == CloseCode.TOO_SLOW
    assert control(ada.listen(now=110.0)) == [PeerAway(peer_id=bob.peer_id, is_away=True)]
    assert come_back(hub, bob.session, now=111.0, name="Bob").peer_id == bob.peer_id
