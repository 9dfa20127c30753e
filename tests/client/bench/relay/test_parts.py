import random
from typing import Any, cast

import pytest

from pica_client.bench.relay import bench
from pica_client.bench.relay.bench import Load, RelayBenchConfig, Target
from pica_client.bench.relay.processes import Workers
from pica_client.bench.relay.traffic import Traffic
from pica_client.errors import OptionError
from pica_protocol.frames import Frame, decode_media, encode_frame, media_message

pytestmark = pytest.mark.unit

STEP_US = 33_333


class Swarm:
    """Stands for the workers and the one swarm that they start, of two peers that lose a frame."""

    def start(self, *_: object, **__: object) -> "Swarm":
        return self

    def order(self, **_: object) -> None:
        pass

    def answer(self, _: float) -> dict[str, Any]:
        counts = {"live": 2, "sent": 10, "received": 9}
        return {**counts, "latency": {}, "turn": {}, "closed": {}, "cpu_ratio": 0.1}


def test_what_a_server_without_metrics_did_not_pass_on_was_dropped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(bench, "SETTLE_S", 0.0)
    config = RelayBenchConfig(rooms=1, peers=2, seconds=0.5)
    load = Load(config, Target(url="ws://relay"), cast("Workers", Swarm()))
    figures = load.measure(1, config.seconds)
    assert (figures["dropped"], figures["missing"]) == (1, 1)


def frames(num: int) -> list[tuple[int, bytes]]:
    traffic = Traffic(random.Random(7))
    return [traffic.next_frame() for _ in range(num)]


def test_simulated_payloads_are_of_twenty_bytes_on_average() -> None:
    sizes = [len(payload) for _, payload in frames(9000)]
    assert 19 < sum(sizes) / len(sizes) < 21


def test_simulated_frames_are_frames_of_the_protocol() -> None:
    for sequence, payload in frames(40):
        frame = Frame(stream=1, sequence=sequence, captured_us=500, payload=payload)
        assert decode_media(media_message([encode_frame(frame)])) == [frame]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rooms": 0}, "rooms is 0; 1 to 10000"),
        ({"peers": 1}, "peers is 1; 2 to 64"),
        ({"fps": 0.5}, "fps is 0.5"),
        ({"seconds": 0}, "seconds is 0"),
        ({"processes": 30}, "processes is 30; 1 to 20"),
        ({"url": "http://x"}, "url 'http://x' is no relay address"),
    ],
)
def test_options_out_of_range_are_named_with_their_limits(
    options: dict[str, object], words: str
) -> None:
    with pytest.raises(OptionError, match=words):
        RelayBenchConfig(**options)  # type: ignore[arg-type]
