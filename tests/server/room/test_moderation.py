"""What an admin may ask for in a room: the hub with literal times."""

import pytest

from helpers.members import FACE, VOICE, Member, counting_secrets
from pica_protocol.errors import CloseCode
from pica_protocol.frames import Frame
from pica_protocol.messages import (
    BarIdentity,
    Moderation,
    MutePeer,
    PeerLeft,
    RemovePeer,
    StreamMuted,
)
from pica_server.config import RelayConfig
from pica_server.room.connections import MODERATION_COST, TOLD_AT_ONCE
from pica_server.room.hub import Hub
from pica_server.room.room import MAX_DECISIONS, Room
from pica_server.tokens import Admission

pytestmark = pytest.mark.unit


def hub_of_identities() -> Hub:
    """Tokens are the identities themselves; the one of Olga has the grant ``admin``."""
    return Hub(
        RelayConfig(),
        lambda join: Admission(identity=join.token, may_admin=join.token == "olga"),
        new_secret=counting_secrets(),
    )


def room_with_admin(*names: str) -> tuple[Hub, Member, list[Member]]:
    """A room with Olga and others who have heard all there is."""
    hub = hub_of_identities()
    olga = Member(hub, "Olga", token="olga", tracks=())
    members = [
        Member(hub, name, token=name.lower(), resumable=True, tracks=(FACE, VOICE))
        for name in names
    ]
    for member in (olga, *members):
        member.listen(now=0.0)
    return hub, olga, members


def ask(admin: Member, asked: Moderation, now: float) -> None:
    admin.session.tell(asked)
    admin.speak(now)


def mute(peer: Member, kind: str = "face", *, is_muted: bool = True) -> MutePeer:
    return MutePeer(peer_id=peer.peer_id, kind=kind, is_muted=is_muted)


def payloads(member: Member, now: float) -> list[bytes]:
    return [each.payload for each in member.listen(now) if isinstance(each, Frame)]


def test_only_who_has_the_grant_is_told_that_they_may_moderate() -> None:
    _, olga, (ada,) = room_with_admin("Ada")
    assert (olga.session.is_admin, ada.session.is_admin) == (True, False)


@pytest.mark.parametrize(
    "asked",
    [
        RemovePeer(peer_id="p1"),
        MutePeer(peer_id="p1", kind="face", is_muted=True),
        BarIdentity(identity="olga", is_barred=True),
    ],
)
def test_who_has_no_grant_is_closed_and_nothing_happens(asked: Moderation) -> None:
    hub, olga, (ada, bob) = room_with_admin("Ada", "Bob")
    ask(ada, asked, now=1.0)
    assert ada.closed_code == CloseCode.FORBIDDEN
    assert hub.stats.limits_hit == {"admission": 1}
    assert olga.closed_code is None
    assert bob.listen(now=1.0) == [PeerLeft(peer_id=ada.peer_id, reason="removed")]


def test_a_grant_reaches_no_other_room_and_nobody_unknown() -> None:
    hub, olga, (ada,) = room_with_admin("Ada")
    bob = Member(hub, "Bob", token="bob", room="elsewhere")
    for peer_id in (bob.peer_id, "p99"):
        ask(olga, RemovePeer(peer_id=peer_id), now=1.0)
        ask(olga, MutePeer(peer_id=peer_id, kind="face", is_muted=True), now=1.0)
    ask(olga, BarIdentity(identity="bob", is_barred=True), now=1.0)
    ask(olga, mute(ada, "smell"), now=1.0)
    assert [each.closed_code for each in (olga, ada, bob)] == [None, None, None]
    assert ada.listen(now=1.0) == bob.listen(now=1.0)[1:] == []


def test_who_moderates_too_often_is_closed() -> None:
    hub, olga, _ = room_with_admin()
    for _ in range(int(TOLD_AT_ONCE / MODERATION_COST)):
        ask(olga, RemovePeer(peer_id="p99"), now=1.0)
    assert olga.closed_code is None
    ask(olga, RemovePeer(peer_id="p99"), now=1.0)
    assert olga.closed_code == CloseCode.TOO_FAST
    assert hub.stats.limits_hit == {"moderation": 1}


def test_frames_of_a_muted_stream_go_nowhere_and_everybody_is_told() -> None:
    hub, olga, (ada, bob) = room_with_admin("Ada", "Bob")
    ada.send_frame(b"waiting", now=1.0)
    ask(olga, mute(ada), now=1.0)
    for member in (ada, bob):
        assert member.listen(now=1.0) == [StreamMuted(stream=ada.stream, is_muted=True)]
    # The publisher's own session would hold them back: one that does not care.
    hub.receive(ada.connection, [b"\x02\x00\x01" + bytes(6)], now=1.1)
    assert bob.listen(now=1.1) == []
    assert hub.stats.dropped["muted"] >= 2
    ask(olga, mute(ada), now=1.2)  # as it is already
    assert ada.listen(now=1.2) == []


def test_a_voice_is_muted_alone_and_goes_on() -> None:
    _, olga, (ada, bob) = room_with_admin("Ada", "Bob")
    voice = ada.session.tracks[1].stream
    ask(olga, mute(ada, "voice"), now=1.0)
    ada.listen(now=1.0)
    assert ada.session.muted == {voice}
    ask(olga, mute(ada, "voice", is_muted=False), now=1.1)
    ada.listen(now=1.1)
    ada.send_frame(b"b", now=1.2, track=1)
    assert payloads(bob, now=1.2) == [b"b"]


def test_a_newcomer_is_told_what_is_muted_and_gets_nothing_of_it() -> None:
    hub, olga, (ada,) = room_with_admin("Ada")
    ada.send_frame(b"before", now=1.0)
    ask(olga, mute(ada), now=1.0)
    cyd = Member(hub, "Cyd", token="cyd", now=2.0)
    assert cyd.session.muted == {ada.stream}
    assert payloads(cyd, now=2.0) == []


def test_a_mute_outlives_its_owners_lost_connection_and_rejoin_but_not_the_room() -> None:
    hub, olga, (ada, bob) = room_with_admin("Ada", "Bob")
    ask(olga, mute(ada), now=1.0)
    ada.listen(now=1.0)
    back = Member(
        hub, "Ada", token="ada", tracks=(FACE, VOICE), now=2.0, former=ada.lose_connection(now=1.5)
    )
    assert back.session.muted == {back.stream}
    hub.disconnect(back.connection, 1000, "", now=3.0)
    bob.listen(now=3.0)
    again = Member(hub, "Ada", token="ada", tracks=(FACE, VOICE), now=4.0)
    assert again.session.muted == {again.stream}, "her face is off, her voice is not"
    assert bob.listen(now=4.0)[1:] == [StreamMuted(stream=again.stream, is_muted=True)]
    for member in (olga, bob, again):
        hub.disconnect(member.connection, 1000, "", now=5.0)
    assert Member(hub, "Ada", token="ada", now=6.0).session.muted == set()


def test_a_removed_peer_is_told_why_and_cannot_come_back_to_its_place() -> None:
    hub, olga, (ada, bob) = room_with_admin("Ada", "Bob")
    ask(olga, RemovePeer(peer_id=ada.peer_id), now=1.0)
    closed = ada.connection.closed
    assert closed is not None
    assert (closed.code, closed.reason) == (
        CloseCode.REMOVED,
        "an admin has removed you from the room",
    )
    assert bob.listen(now=1.0) == [PeerLeft(peer_id=ada.peer_id, reason="removed")]
    again = Member(hub, "Ada", token="ada", now=2.0, former=ada.session)
    assert again.peer_id not in ("", ada.peer_id)


def test_a_peer_that_is_away_can_be_removed() -> None:
    hub, olga, (ada, bob) = room_with_admin("Ada", "Bob")
    former = ada.lose_connection(now=1.0)
    ask(olga, RemovePeer(peer_id=ada.peer_id), now=2.0)
    bob.listen(now=2.0)
    assert ada.peer_id not in bob.session.peers
    assert Member(hub, "Ada", token="ada", now=3.0, former=former).peer_id != ada.peer_id


def test_a_barred_identity_stays_out_until_the_room_is_empty() -> None:
    hub, olga, (ada,) = room_with_admin("Ada")
    ask(olga, BarIdentity(identity="ada", is_barred=True), now=1.0)
    assert ada.closed_code == CloseCode.REMOVED
    refused = Member(hub, "Ada", token="ada", now=2.0).connection.closed
    assert refused is not None
    assert refused.code == CloseCode.FORBIDDEN
    assert refused.reason == "an admin has barred you until the room is empty"
    assert Member(hub, "Ada", token="ada", room="elsewhere", now=2.0).closed_code is None
    hub.disconnect(olga.connection, 1000, "", now=3.0)
    assert Member(hub, "Ada", token="ada", now=4.0).closed_code is None


def test_a_bar_may_be_lifted_and_given_to_who_is_not_there_yet() -> None:
    hub, olga, _ = room_with_admin()
    ask(olga, BarIdentity(identity="ada", is_barred=True), now=1.0)
    assert Member(hub, "Ada", token="ada", now=1.0).closed_code == CloseCode.FORBIDDEN
    ask(olga, BarIdentity(identity="ada", is_barred=False), now=2.0)
    assert Member(hub, "Ada", token="ada", now=2.0).closed_code is None


def test_a_room_remembers_a_bounded_number_of_decisions_and_none_about_nobody() -> None:
    room = Room("lobby", capacity=5)
    room.decide("", "face", holds=True)
    for number in range(MAX_DECISIONS + 1):
        room.decide(f"n{number}", "face", holds=True)
    held = [room.is_decided(name, "face") for name in ("", "n0", "n1", f"n{MAX_DECISIONS}")]
    assert held == [False, False, True, True]
