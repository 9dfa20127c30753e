import random
import socket

import pytest

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
