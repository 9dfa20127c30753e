import json
from http import HTTPStatus
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

from helpers.members import FACE, VOICE, Member
from pica_protocol.errors import CloseCode
from pica_server.config import LimitsConfig, RelayConfig
from pica_server.limits import RefusalError
from pica_server.pages import MAX_LISTED, Page, StatusPages
from pica_server.room.hub import Hub
from pica_server.stats import BOUNDS_S, RelayStats, metrics_text

pytestmark = pytest.mark.unit


def numbers(text: str) -> dict[tuple[str, str], float]:
    """Return name and label of each sample, as Prometheus reads them."""
    return {
        (sample.name, "".join(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def admin_room(token: str) -> str:
    """Tokens are the rooms that they are for."""
    if not token:
        raise RefusalError("this relay wants a token", CloseCode.UNAUTHORIZED)
    if token == "nobody":
        raise RefusalError("the token does not let you manage rooms", CloseCode.FORBIDDEN)
    return token


def pages(config: RelayConfig | None = None) -> tuple[StatusPages, Hub]:
    config = config or RelayConfig()
    hub = Hub(config)
    return StatusPages(hub, config, None, admin_room), hub


def status(pages: StatusPages, path: str, now: float) -> int | None:
    page = pages.answer(path, is_local=True, now=now)
    return None if page is None else page.status


def test_a_relay_that_is_full_or_sends_everybody_away_is_not_ready_but_well() -> None:
    answers, hub = pages(RelayConfig(max_connections=1))
    assert status(answers, "/readyz", now=0.0) == 200
    hub.connect(now=0.0)
    assert status(answers, "/readyz", now=0.0) == 503
    assert status(answers, "/healthz", now=0.0) == 200
    answers, hub = pages()
    hub.drain(now=0.0)
    page = answers.answer("/readyz", is_local=True, now=0.0)
    assert page == Page(HTTPStatus.SERVICE_UNAVAILABLE, "draining\n")
    assert status(answers, "/healthz", now=0.0) == 200


def test_every_line_of_the_numbers_is_one_that_prometheus_reads() -> None:
    answers, hub = pages(RelayConfig(limits=LimitsConfig(connections_per_address=1)))
    for _ in range(2):
        Member(hub, "Ada", address="192.0.2.1")
    hub.stats.dropped["replaced"] += 3
    hub.stats.frames_in += 1_234_567
    page = answers.answer("/metrics", is_local=True, now=0.0)
    assert page is not None
    assert page.content_type.startswith("text/plain; version=0.0.4")
    assert numbers(page.text)["pica_frames_dropped_total", "replaced"] == 3
    assert numbers(page.text)["pica_frames_in_total", ""] == 1_234_567
    assert numbers(page.text)["pica_limits_hit_total", "address"] == 1
    assert numbers(page.text)["pica_closed_total", "4010"] == 1
    assert "192.0.2.1" not in page.text


def test_the_latency_histogram_is_cumulative_and_complete() -> None:
    stats = RelayStats()
    latencies_s = (0.0001, 0.0009, 0.004, 0.03, 3.0, 100.0)
    for latency_s in latencies_s:
        stats.forwarding.record(latency_s)
    text = metrics_text(stats, {})
    found = numbers(text)
    counts = [value for (name, _), value in found.items() if name.endswith("_seconds_bucket")]
    expected = [sum(latency_s <= bound_s for latency_s in latencies_s) for bound_s in BOUNDS_S]
    assert counts == [*expected, len(latencies_s)]
    assert found["pica_forward_seconds_sum", ""] == pytest.approx(sum(latencies_s))


def rooms(answers: StatusPages, authorization: str) -> tuple[int, Any]:
    page = answers.answer("/rooms", authorization=authorization, is_local=True, now=0.0)
    assert page is not None
    is_json = page.content_type == "application/json"
    return page.status, json.loads(page.text) if is_json else dict(page.headers)


def test_an_admin_sees_the_rooms_of_the_token_and_who_is_in_them() -> None:
    answers, hub = pages()
    ada = Member(hub, "Ada", tracks=(FACE, VOICE))
    Member(hub, "Bob", room="attic", tracks=())
    lobby = hub.membership.rooms.get("lobby")
    assert lobby is not None
    hub.connections.mute(lobby, lobby.streams[ada.stream], is_muted=True, now=0.0)
    status, found = rooms(answers, "Bearer lobby")
    assert status == 200
    tracks = [
        {"kind": "face", "stream": 1, "is_muted": True},
        {"kind": "voice", "stream": 2, "is_muted": False},
    ]
    person = {"peer_id": ada.peer_id, "name": "Ada", "identity": "", "is_away": False}
    assert found == {
        "rooms": [{"room": "lobby", "people": [{**person, "tracks": tracks}]}],
        "is_cut": False,
    }
    names = [room["room"] for room in rooms(answers, "bearer *")[1]["rooms"]]
    assert names == ["lobby", "attic"]
    assert rooms(answers, "Bearer nowhere")[1]["rooms"] == []


@pytest.mark.parametrize(
    ("authorization", "status"),
    [("", 401), ("lobby", 401), ("Basic lobby", 401), ("Bearer ", 401), ("Bearer nobody", 403)],
)
def test_rooms_are_shown_to_nobody_without_an_admins_token(authorization: str, status: int) -> None:
    answers, _ = pages()
    found, headers = rooms(answers, authorization)
    assert found == status
    assert headers == ({"WWW-Authenticate": "Bearer"} if status == 401 else {})


def test_the_list_of_rooms_is_bounded_and_says_when_it_is_cut() -> None:
    answers, hub = pages(RelayConfig(max_connections=2000, limits=LimitsConfig(joins_burst=2e3)))
    for number in range(MAX_LISTED + 1):
        Member(hub, "Ada", room=f"r{number // 16}", tracks=())
    _, found = rooms(answers, "Bearer *")
    assert sum(len(room["people"]) for room in found["rooms"]) == MAX_LISTED
    assert found["is_cut"]
