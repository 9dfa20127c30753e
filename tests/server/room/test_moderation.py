"""What an admin may do to a room: the hub with literal times."""

import pytest

from helpers.members import FACE, VOICE, Member, counting_secrets, hub_with
from pica_protocol.errors import CloseCode
from pica_protocol.frames import Frame
from pica_protocol.messages import KeyframeRequest, PeerLeft, StreamMuted
from pica_server.auth.tokens import Admission
from pica_server.config.relay import RelayConfig
from pica_server.room.hub import Hub
from pica_server.room.rulings import RULING_S

pytestmark = pytest.mark.unit


def payloads(member: Member, now: float) -> list[bytes]:
    return [each.payload for each in member.listen(now) if isinstance(each, Frame)]


def test_frames_of_a_muted_stream_go_nowhere_and_everybody_is_told() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob")
    ada.send_frame(b"waiting", now=1.0)
    assert hub.moderation.mute("lobby", ada.stream, is_muted=True, now=1.0)
    for member in (ada, bob):
        assert member.listen(now=1.0) == [StreamMuted(stream=ada.stream, is_muted=True)]
    # The publisher's own session would hold them back: one that does not care.
    hub.receive(ada.connection, b"\x02\x00\x01" + bytes(3) + b"\x01" + bytes(10), now=1.1)
    assert bob.listen(now=1.1) == []
    assert hub.stats.dropped == {"muted": 2}
    assert hub.moderation.mute("lobby", ada.stream, is_muted=True, now=1.2)  # as it is already
    assert ada.listen(now=1.2) == []


def test_a_stream_that_may_go_on_begins_with_a_keyframe_that_is_asked_for() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob")
    ada.send_frame(b"key", now=1.0)
    hub.moderation.mute("lobby", ada.stream, is_muted=True, now=1.0)
    for member in (ada, bob):
        member.listen(now=1.0)
    hub.moderation.mute("lobby", ada.stream, is_muted=False, now=1.1)
    assert ada.listen(now=1.1) == [
        StreamMuted(stream=ada.stream, is_muted=False),
        KeyframeRequest(stream=ada.stream),
    ]
    ada.send_frame(b"delta", now=1.2, is_keyframe=False)
    assert payloads(bob, now=1.2) == []
    ada.send_frame(b"key", now=1.3)
    ada.send_frame(b"delta", now=1.4, is_keyframe=False)
    assert payloads(bob, now=1.4) == [b"key", b"delta"]


def test_a_newcomer_is_told_what_is_muted_and_gets_nothing_of_it() -> None:
    hub, (ada, _bob) = hub_with("Ada", "Bob")
    ada.send_frame(b"before", now=1.0)
    hub.moderation.mute("lobby", ada.stream, is_muted=True, now=1.0)
    cyd = Member(hub, "Cyd", now=2.0)
    assert cyd.session.muted == {ada.stream}
    assert payloads(cyd, now=2.0) == []


def test_a_muted_peer_that_comes_back_is_still_muted() -> None:
    hub, (ada, _bob) = hub_with("Ada", "Bob", resumable=True)
    hub.moderation.mute("lobby", ada.stream, is_muted=True, now=1.0)
    ada.listen(now=1.0)
    again = Member(hub, "Ada", now=2.0, ticket=ada.lose_connection(now=1.5), resumable=True)
    assert again.session.muted == {again.stream}


def test_a_voice_that_was_muted_goes_on_at_once_and_is_asked_for_no_keyframe() -> None:
    hub, _ = hub_with()
    ada, bob = Member(hub, "Ada", tracks=(VOICE,)), Member(hub, "Bob")
    ada.send_frame(b"a", now=1.0)
    hub.moderation.mute("lobby", ada.stream, is_muted=True, now=1.0)
    hub.moderation.mute("lobby", ada.stream, is_muted=False, now=1.1)
    ada.listen(now=1.1)
    ada.send_frame(b"b", now=1.2, is_keyframe=False)
    assert payloads(bob, now=1.2) == [b"b"]
    assert not hub.stats.keyframe_requests


def test_a_removed_peer_is_told_and_gone_and_cannot_come_back_to_its_place() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob", resumable=True)
    assert hub.moderation.remove("lobby", ada.peer_id, now=1.0)
    assert ada.closed_code == CloseCode.REMOVED
    assert bob.listen(now=1.0) == [PeerLeft(peer_id=ada.peer_id, reason="removed")]
    again = Member(hub, "Ada", now=2.0, ticket=ada.session.ticket)
    assert again.peer_id not in ("", ada.peer_id)


def test_a_peer_that_is_away_can_be_removed() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob", resumable=True)
    ticket = ada.lose_connection(now=1.0)
    assert hub.moderation.remove("lobby", ada.peer_id, now=2.0)
    bob.listen(now=2.0)
    assert list(bob.session.peers) == []
    assert Member(hub, "Ada", now=3.0, ticket=ticket).peer_id != ada.peer_id
    hub.handle_timer(now=20.0)


class Clock:
    """Seconds since 1970, as the hub's rulings see them."""

    now_s = 1_800_000_000.0

    def __call__(self) -> float:
        return self.now_s


def hub_of_identities(clock: Clock) -> Hub:
    """Tokens are the identities themselves."""
    return Hub(
        RelayConfig(),
        lambda join: Admission(identity=join.token),
        new_secret=counting_secrets(),
        unix_time=clock,
    )


def test_a_mute_outlives_its_owners_rejoin_and_everybody_is_told() -> None:
    hub = hub_of_identities(Clock())
    ada = Member(hub, "Ada", token="ada", tracks=(FACE, VOICE))
    bob = Member(hub, "Bob", token="bob")
    hub.moderation.mute("lobby", ada.stream, is_muted=True, now=1.0)
    hub.disconnect(ada.connection, 1000, "", now=2.0)
    bob.listen(now=2.0)
    again = Member(hub, "Ada", token="ada", tracks=(FACE, VOICE), now=3.0)
    assert again.session.muted == {again.stream}, "her face is off, her voice is not"
    assert bob.listen(now=3.0)[1:] == [StreamMuted(stream=again.stream, is_muted=True)]
    hub.receive(again.connection, b"\x02\x00\x04" + bytes(3) + b"\x01" + bytes(10), now=3.1)
    assert payloads(bob, now=3.1) == []
    assert Member(hub, "Ada", token="ada", room="elsewhere", now=4.0).session.muted == set()
    hub.moderation.mute("lobby", again.stream, is_muted=False, now=5.0)
    hub.disconnect(again.connection, 1000, "", now=6.0)
    assert Member(hub, "Ada", token="ada", now=7.0).session.muted == set()


def test_an_order_about_somebody_else_stops_no_other_stream_of_who_is_muted() -> None:
    hub = hub_of_identities(Clock())
    ada = Member(hub, "Ada", token="ada", tracks=(FACE, FACE))
    hub.moderation.mute("lobby", ada.stream, is_muted=True, now=1.0)
    hub.moderation.bar("lobby", "mallory", now=2.0)
    ada.listen(now=2.0)
    assert ada.session.muted == {ada.stream}


def test_a_mute_ends_after_a_day_and_not_with_the_room() -> None:
    clock = Clock()
    hub = hub_of_identities(clock)
    ada = Member(hub, "Ada", token="ada")
    hub.moderation.mute("lobby", ada.stream, is_muted=True, now=1.0)
    hub.disconnect(ada.connection, 1000, "", now=2.0)
    assert hub.num_rooms == 0
    clock.now_s += RULING_S - 2
    assert Member(hub, "Ada", token="ada", now=3.0).session.muted
    clock.now_s += 3
    assert not Member(hub, "Ada", token="ada", now=4.0).session.muted


def test_an_identity_that_is_barred_stays_out_for_its_time_and_not_only_while_the_room_lasts() -> (
    None
):
    clock = Clock()
    hub = hub_of_identities(clock)
    ada = Member(hub, "Ada", token="ada")
    assert hub.moderation.bar("lobby", "ada", lasts_s=60, now=1.0)
    assert ada.closed_code == CloseCode.REMOVED
    assert Member(hub, "Ada", token="ada", now=2.0).closed_code == CloseCode.FORBIDDEN
    assert Member(hub, "Ada", token="ada", room="elsewhere", now=2.0).closed_code is None
    clock.now_s += 59
    assert Member(hub, "Ada", token="ada", now=3.0).closed_code == CloseCode.FORBIDDEN
    clock.now_s += 1
    assert Member(hub, "Ada", token="ada", now=4.0).closed_code is None


def test_a_bar_may_be_lifted_and_who_has_no_identity_cannot_be_barred() -> None:
    hub = hub_of_identities(Clock())
    assert hub.moderation.bar("lobby", "ada", now=1.0)
    assert Member(hub, "Ada", token="ada", now=1.0).closed_code == CloseCode.FORBIDDEN
    assert hub.moderation.bar("lobby", "ada", is_barred=False, now=2.0)
    assert Member(hub, "Ada", token="ada", now=2.0).closed_code is None
    assert not hub.moderation.bar("lobby", "", now=3.0)


def test_a_closed_room_is_empty_and_its_peers_know_why() -> None:
    hub, (ada, bob, cyd) = hub_with("Ada", "Bob", "Cyd", resumable=True)
    other = Member(hub, "Dot", room="elsewhere")
    cyd.lose_connection(now=0.5)
    assert hub.moderation.close_room("lobby", now=1.0) == 3
    assert ada.closed_code == bob.closed_code == CloseCode.ROOM_CLOSED
    assert [room.name for room in hub.membership.rooms.values()] == ["elsewhere"]
    assert other.closed_code is None
    assert not any(isinstance(each, PeerLeft) for each in ada.listen(now=1.0))


def test_what_is_not_there_cannot_be_muted_removed_or_closed() -> None:
    hub, (ada,) = hub_with("Ada")
    assert not hub.moderation.mute("lobby", 99, is_muted=True, now=1.0)
    assert not hub.moderation.mute("nowhere", 1, is_muted=True, now=1.0)
    assert not hub.moderation.remove("lobby", "p99", now=1.0)
    assert not hub.moderation.remove("nowhere", ada.peer_id, now=1.0)
    assert hub.moderation.close_room("nowhere", now=1.0) is None
