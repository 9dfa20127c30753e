import random
import socket

import pytest

from pica_client.bench.relay import peer
from pica_client.bench.relay.bench import Reading, RelayBenchConfig, figures
from pica_client.bench.relay.peer import STEP_US, SwarmPeer, Tally
from pica_client.bench.relay.swarm import Swarm
from pica_client.errors import OptionError
from pica_protocol.frames import MEDIA_KIND, decode_media

pytestmark = pytest.mark.unit


def test_what_a_server_without_metrics_did_not_pass_on_was_dropped() -> None:
    swarm = Swarm(fps=30.0, seed=0)
    swarm.tally.sent, swarm.tally.received = 10, 9
    swarm.tally.latency.update({10: 8, 100: 1})
    nothing = Reading({}, None, 0.0)
    config = RelayBenchConfig(rooms=1, peers=2, seconds=0.5)
    found = figures(config, swarm, nothing, nothing)
    assert (found["dropped"], found["missing"]) == (1, 1)
    assert found["forward_ms"] == {"p50": 0.11, "p95": 1.01, "p99": 1.01}


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
    assert tally.latency == {1500 // STEP_US: 1}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rooms": 0}, "rooms is 0; 1 to 10000"),
        ({"url": "http://x"}, "url 'http://x' is no relay address"),
    ],
)
def test_options_out_of_range_are_named_with_their_limits(
    options: dict[str, object], words: str
) -> None:
    with pytest.raises(OptionError, match=words):
        RelayBenchConfig(**options)  # type: ignore[arg-type]
