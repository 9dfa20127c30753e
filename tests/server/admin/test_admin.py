"""The admin's requests against a hub: who may, what happens, what is answered."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.members import Member, hub_with
from pica_protocol.errors import CloseCode
from pica_protocol.messages import Join
from pica_server.admin.admin import Admin
from pica_server.auth.tokens import Admission, KeyRing, admin_scope, admit, mint
from pica_server.config.relay import RelayConfig
from pica_server.errors import AdmissionError
from pica_server.room.hub import Hub

pytestmark = pytest.mark.unit

HERE = {"host": "127.0.0.1:8766"}
KEYS = KeyRing({"k": b"k" * 32})
NOW = 1_800_000_000.0


def asking(hub: Hub, *, has_keys: bool = False) -> Callable[..., tuple[int, dict[str, Any]]]:
    admin = Admin(hub, (lambda token: token) if has_keys else None)
    headers = {**HERE, "authorization": "Bearer *"}

    def ask(method: str, path: str) -> tuple[int, dict[str, Any]]:
        answer = admin.answer(method, path, headers, now=1.0)
        return int(answer.status), answer.body

    return ask


def test_rooms_are_listed_with_their_numbers() -> None:
    hub, (ada, _) = hub_with("Ada", "Bob", resumable=True)
    ada.lose_connection(now=0.5)
    assert asking(hub)("GET", "/v1/rooms") == (
        200,
        {
            "rooms": [
                {
                    "room": "lobby",
                    "num_peers": 2,
                    "num_here": 2,
                    "num_away": 1,
                    "num_streams": 2,
                    "num_muted": 0,
                }
            ]
        },
    )


def test_a_room_is_shown_with_its_peers_and_their_streams() -> None:
    hub, _ = hub_with()
    ada = Member(hub, "Ada", metadata=(("hand", "up"),))
    Member(hub, "Bob", tracks=())
    ada.send_frame(b"x", now=0.5)
    status, room = asking(hub)("GET", "/v1/rooms/lobby")
    first, second = room["peers"]
    assert status == 200
    assert (first["name"], first["metadata"], first["away"]) == ("Ada", {"hand": "up"}, False)
    assert first["tracks"] == [
        {"stream": 1, "kind": "face", "policy": "latest", "avatar": "", "muted": False}
    ]
    assert (second["tracks"], second["waiting_frames"]) == ([], 1)
    assert asking(hub)("GET", f"/v1/rooms/lobby/peers/{ada.peer_id}") == (200, first)


def test_a_peer_is_muted_and_may_go_on_as_often_as_it_is_asked() -> None:
    hub, (ada, _) = hub_with("Ada", "Bob")
    ask = asking(hub)
    for method, is_muted in (("PUT", True), ("PUT", True), ("DELETE", False)):
        status, answer = ask(method, f"/v1/rooms/lobby/peers/{ada.peer_id}/muted")
        assert (status, answer["muted"], answer["streams"]) == (200, is_muted, [ada.stream])
        ada.listen(now=1.0)
        assert bool(ada.session.muted) is is_muted
    assert ask("PUT", f"/v1/rooms/lobby/streams/{ada.stream}/muted")[0] == 200
    ada.listen(now=1.0)
    assert ada.session.muted == {ada.stream}


def test_a_peer_is_removed_and_a_room_closed() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob")
    ask = asking(hub)
    assert ask("DELETE", f"/v1/rooms/lobby/peers/{ada.peer_id}") == (
        200,
        {"room": "lobby", "peer_id": ada.peer_id, "removed": True, "barred": False},
    )
    assert ada.closed_code == CloseCode.REMOVED
    assert ask("DELETE", "/v1/rooms/lobby") == (200, {"room": "lobby", "removed": 1})
    assert bob.closed_code == CloseCode.ROOM_CLOSED
    assert ask("GET", "/v1/rooms") == (200, {"rooms": []})


def test_an_identity_is_barred_for_a_time_whether_it_is_there_or_not_and_let_in_again() -> None:
    hub = Hub(RelayConfig(), lambda join: Admission(identity=join.token))
    ask = asking(hub, has_keys=True)
    ada = Member(hub, "Ada", token="ada")
    status, answer = ask("DELETE", f"/v1/rooms/lobby/peers/{ada.peer_id}?bar=true&for_s=60")
    assert (status, answer["barred"]) == (200, True)
    assert ada.closed_code == CloseCode.REMOVED
    bars = "/v1/rooms/lobby/bars/ada"
    for method, is_barred in (("PUT", True), ("DELETE", False)):
        assert ask(method, bars) == (
            200,
            {"room": "lobby", "identity": "ada", "barred": is_barred},
        )
        code = CloseCode.FORBIDDEN if is_barred else None
        assert Member(hub, "Ada", token="ada").closed_code == code
    for for_s in ("0", "2592001", "nan", "soon"):
        status, answer = ask("PUT", f"{bars}?for_s={for_s}")
        assert status == 400
        assert answer["error"].startswith("for_s must be 1 to 2592000 seconds, got")


@pytest.mark.parametrize("method", ["PUT", "DELETE"])
def test_a_bar_that_would_hold_nobody_is_refused(method: str) -> None:
    hub, _ = hub_with("Ada")
    assert asking(hub)(method, "/v1/rooms/lobby/bars/ada") == (
        409,
        {"error": "this relay has no keys, so nobody has an identity"},
    )
    for path in ("lobby/bars/", "lobby/bars/Ada%20L", "no%20room/bars/ada"):
        status, answer = asking(hub, has_keys=True)(method, f"/v1/rooms/{path}")
        assert (status, "must be 1..64 of" in answer["error"]) == (400, True)


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/", 404),
        ("GET", "/v1/rooms/lobby/bars/ada", 405),
        ("GET", "/v1", 404),
        ("GET", "/v1/rooms/nowhere", 404),
        ("DELETE", "/v1/rooms/lobby/peers/p99", 404),
        ("PUT", "/v1/rooms/lobby/streams/99/muted", 404),
        ("PUT", "/v1/rooms/lobby/streams/%C2%B2/muted", 404),
        ("PUT", "/v1/rooms/lobby/streams/-1/muted", 404),
        ("GET", "/v1/rooms/lobby/what", 404),
        ("GET", "/v1/rooms/..%2f..%2fetc", 404),
        ("POST", "/v1/rooms", 405),
        ("PATCH", "/v1/rooms/lobby", 405),
        ("GET", "http://[", 400),
    ],
)
def test_what_is_not_there_or_cannot_be_done_is_refused(
    method: str, path: str, status: int
) -> None:
    hub, _ = hub_with("Ada")
    found, answer = asking(hub)(method, path)
    assert found == status
    assert set(answer) == {"error"}
    assert hub.num_connections == 1


def admin_of(hub: Hub) -> Admin:
    return Admin(hub, lambda token: admin_scope(KEYS, token, now=NOW))


def token(*, room: str, may_admin: bool = True) -> str:
    admission = Admission(identity="op", may_admin=may_admin)
    return mint(KEYS, room, admission, now=NOW, lasts_s=60, starts_s=0)


def bearer(shown: str) -> dict[str, str]:
    return {"authorization": f"Bearer {shown}", "host": "relay.example.org"}


def test_with_keys_an_admins_token_is_wanted_and_a_room_of_its_own_is_all_it_opens() -> None:
    hub, _ = hub_with("Ada")
    Member(hub, "Dot", room="elsewhere")
    admin = admin_of(hub)
    everywhere, here = bearer(token(room="*")), bearer(token(room="lobby"))
    assert len(admin.answer("GET", "/v1/rooms", everywhere, 1.0).body["rooms"]) == 2
    (room,) = admin.answer("GET", "/v1/rooms", here, 1.0).body["rooms"]
    assert room["room"] == "lobby"
    assert admin.answer("GET", "/v1/rooms/lobby", here, 1.0).status == 200
    for path in ("/v1/rooms/elsewhere", "/v1/rooms/nowhere"):
        assert admin.answer("DELETE", path, here, 1.0).status == 403
    assert hub.num_rooms == 2


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 401),
        (HERE, 401),
        ({"authorization": "Basic b3A6b3A="}, 401),
        (bearer(""), 401),
        (bearer("a.b.c"), 401),
        (bearer(token(room="lobby", may_admin=False)), 403),
    ],
)
def test_who_has_no_admins_token_is_refused_and_nothing_happens(
    headers: dict[str, str], status: int
) -> None:
    hub, (ada,) = hub_with("Ada")
    answer = admin_of(hub).answer("DELETE", "/v1/rooms/lobby", headers, 1.0)
    assert answer.status == status
    assert (("WWW-Authenticate", "Bearer") in answer.headers) is (status == 401)
    assert ada.closed_code is None


def test_an_admins_token_for_all_rooms_lets_nobody_into_one() -> None:
    with pytest.raises(AdmissionError, match="another room"):
        admit(KEYS, Join(room="lobby", name="op", token=token(room="*")), now=NOW)
    with pytest.raises(ValueError, match="room must be"):
        token(room="*", may_admin=False)


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"host": "evil.example.org"},
        {"host": "127.0.0.1.evil.example.org"},
        {"host": "192.168.1.2:8766"},
        {"host": "localhost:8766", "origin": "https://evil.example.org"},
        {"host": "localhost:8766", "origin": "null"},
    ],
)
def test_without_keys_no_web_page_manages_rooms(headers: dict[str, str]) -> None:
    hub, (ada,) = hub_with("Ada")
    answer = Admin(hub, None).answer("DELETE", "/v1/rooms/lobby", headers, 1.0)
    assert answer.status == 403
    assert ada.closed_code is None


@given(
    method=st.sampled_from(["GET", "PUT", "DELETE", "POST", "x"]) | st.text(max_size=5),
    target=st.text(max_size=40)
    | st.lists(
        st.sampled_from(["v1", "rooms", "lobby", "peers", "p1", "streams", "1", "muted", "", "%"]),
        max_size=8,
    ).map(lambda parts: "/" + "/".join(parts)),
    headers=st.dictionaries(st.sampled_from(["host", "origin", "authorization"]), st.text()),
)
def test_whatever_is_asked_is_answered(method: str, target: str, headers: dict[str, str]) -> None:
    hub, _ = hub_with("Ada", "Bob")
    for admin in (Admin(hub, None), admin_of(hub)):
        assert admin.answer(method, target, headers, 1.0).status in (200, 400, 401, 403, 404, 405)
    assert Admin(hub, None).answer(method, target, HERE, 1.0).status in (200, 400, 404, 405)
