import random
import socket

import pytest

from pica_client.bench.harness import ratio, take_turns, times_ms
from pica_client.bench.relay import peer
from pica_client.bench.relay.peer import SwarmPeer, Tally
from pica_protocol.frames import MEDIA_KIND, decode_media

pytestmark = pytest.mark.unit


def test_a_peer_sends_frames_of_the_protocol_with_the_sizes_of_a_face(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ours, theirs = socket.socketpair()
    monkeypatch.setattr(peer, "_connect", lambda _: ours)
    with ours, theirs:
        tally = Tally()
        tally.end_us = 1_000_000
        sender = SwarmPeer("ws://relay", "room", "name", random.Random(7), tally)
        theirs.recv(65_536)  # the handshake
        sender.is_live, sender.stream = True, 1
        sizes = []
        for _ in range(900):
            sender.send_frame(500)
            data = theirs.recv(65_536)
            assert data[0] == 0x82
            assert data[6] == MEDIA_KIND
            (frame,) = decode_media(data[6:])
            sizes.append(len(frame.payload))
    assert tally.sent == 900
    assert 19 < sum(sizes) / len(sizes) < 21


def test_a_frame_is_counted_by_the_time_from_capture_to_receipt() -> None:
    tally = Tally()
    tally.begin_us, tally.end_us, tally.now_us = 1000, 2000, 2500
    for captured_us in (999, 1000, 2000):
        tally.count_received(captured_us)
    assert tally.delays_us.tolist() == [1500]


def test_cases_work_once_a_round_and_every_second_round_backwards() -> None:
    order: list[str] = []

    def work(case: str, number: int) -> tuple[str, int]:
        order.append(case)
        return case, number

    found = take_turns("abc", work, rounds=3, warm_up=1)
    assert "".join(order) == "abc" + "abc" + "cba" + "abc"
    assert found == [[(case, number) for number in range(3)] for case in "abc"]


def test_times_are_told_in_milliseconds_and_their_spread_as_a_share() -> None:
    times = times_ms([0.003, 0.001, 0.002])
    assert times == {"ms": 2, "p95": 3, "spread": 1}
    assert times_ms([1.0])["spread"] == 0


def test_a_ratio_compares_times_of_the_same_round() -> None:
    assert ratio([4.0, 20.0, 3.0], [2.0] * 3) == 2
