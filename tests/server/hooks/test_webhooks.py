"""What waits for a webhook, and how it is signed: literal times, no socket."""

import hashlib
import hmac
import json
from collections import Counter
from itertools import count

import pytest

from pica_server.config.relay import RelayConfig, WebhookConfig
from pica_server.errors import ConfigurationError
from pica_server.hooks.webhooks import Delivery, RoomEvent, WebhookQueue, signature

pytestmark = pytest.mark.unit


def queue(max_waiting: int = 10, give_up_s: float = 600.0) -> tuple[WebhookQueue, Counter[str]]:
    counts: Counter[str] = Counter()
    numbers = count()
    waiting = WebhookQueue(
        max_waiting=max_waiting,
        give_up_s=give_up_s,
        new_id=lambda: f"e{next(numbers)}",
        random=lambda: 1.0,
        counts=counts,
    )
    return waiting, counts


def offer(waiting: WebhookQueue, now: float = 0.0) -> None:
    waiting.offer(RoomEvent(event="room_started", room="lobby"), unix_s=1e9, now=now)


def taken(waiting: WebhookQueue, now: float) -> Delivery:
    delivery = waiting.take(now)
    assert delivery is not None
    return delivery


def test_an_event_says_what_happened_and_nothing_that_is_empty() -> None:
    waiting, _ = queue()
    notice = RoomEvent(event="peer_left", room="lobby", peer_id="p1", name="Ada", reason="lost")
    waiting.offer(notice, unix_s=1_700_000_000.5, now=0.0)
    assert json.loads(taken(waiting, 0.0).body) == {
        "id": "e0",
        "created": 1_700_000_000.5,
        "event": "peer_left",
        "room": "lobby",
        "peer_id": "p1",
        "name": "Ada",
        "reason": "lost",
    }


def test_a_signature_is_what_the_page_says_and_changes_with_time_body_and_secret() -> None:
    body, secret = b'{"id": "e0"}', b"s" * 32
    expected = hmac.new(secret, b"1700000000." + body, hashlib.sha256).hexdigest()
    made = signature(secret, body, 1_700_000_000)
    assert made == f"t=1700000000,v1={expected}"
    others = [
        signature(secret, body, 1_700_000_001),
        signature(secret, body + b" ", 1_700_000_000),
        signature(b"t" * 32, body, 1_700_000_000),
    ]
    assert made not in others


def test_events_go_out_one_after_the_other_in_order() -> None:
    waiting, counts = queue()
    for _ in range(3):
        offer(waiting)
    for i in range(3):
        assert taken(waiting, 0.0).event_id == f"e{i}"
        assert waiting.take(0.0) is None
        assert waiting.next_timer() is None
        waiting.delivered()
    assert len(waiting) == 0
    assert counts == {"delivered": 3}


def test_what_fails_is_tried_again_after_waits_that_double_up_to_a_minute() -> None:
    waiting, counts = queue(give_up_s=1e9)
    offer(waiting)
    now, waits = 0.0, []
    for _ in range(10):
        assert taken(waiting, now).event_id == "e0"
        waiting.failed(now)
        due = waiting.next_timer()
        assert due is not None
        assert waiting.take(due - 0.01) is None
        waits.append(due - now)
        now = due
    assert waits == [0.5, 1, 2, 4, 8, 16, 32, 60, 60, 60]
    taken(waiting, now)
    waiting.delivered()
    offer(waiting)
    taken(waiting, now)
    waiting.failed(now)
    assert waiting.next_timer() == now + 0.5
    assert counts == {"failed": 11, "delivered": 1}


def test_too_many_drop_the_oldest_that_waits_but_not_the_one_under_way() -> None:
    waiting, counts = queue(max_waiting=3)
    for _ in range(3):
        offer(waiting)
    assert taken(waiting, 0.0).event_id == "e0"
    for _ in range(4):
        offer(waiting)
        assert len(waiting) == 3
    waiting.delivered()
    assert taken(waiting, 0.0).event_id == "e5"
    assert counts["overflow"] == 4


def test_a_queue_of_one_drops_what_comes_while_it_is_under_way() -> None:
    waiting, counts = queue(max_waiting=1)
    offer(waiting)
    taken(waiting, 0.0)
    offer(waiting)
    waiting.failed(0.0)
    assert (len(waiting), counts["overflow"]) == (1, 1)


def test_what_is_too_old_is_dropped_and_counted() -> None:
    waiting, counts = queue(give_up_s=10.0)
    offer(waiting, now=0.0)
    offer(waiting, now=5.0)
    assert taken(waiting, 11.0).event_id == "e1"
    assert counts == {"expired": 1}


@pytest.mark.parametrize(
    "url", ["ftp://a", "https://", "http://a b", "https://user:pw@host/", "http://a:99999/"]
)
def test_what_is_no_address_is_refused(url: str) -> None:
    with pytest.raises(ConfigurationError, match=r"--webhook\.url is no address"):
        RelayConfig(webhook=WebhookConfig(url=url))
