import random
from collections import Counter
from typing import Any, cast

import pytest

from pica_client.bench.relay import bench
from pica_client.bench.relay.bench import Load, RelayBenchConfig, Target
from pica_client.bench.relay.processes import Workers
from pica_client.bench.relay.traffic import KEYFRAME_INTERVAL_S, KEYFRAME_PAUSE_S, Traffic
from pica_client.errors import OptionError
from pica_protocol.frames import FLAG_KEYFRAME, Frame, decode_media, encode_frame, media_message

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


def frames(num: int) -> list[tuple[int, int, bool, bytes]]:
    traffic = Traffic(random.Random(7))
    return [traffic.next_frame(index * STEP_US) for index in range(num)]


def test_simulated_payloads_are_of_six_bytes_on_average_and_keyframes_of_twice_that() -> None:
    sizes = [len(payload) for _, _, is_keyframe, payload in frames(9000) if not is_keyframe]
    assert 5.5 < sum(sizes) / len(sizes) < 6.5
    assert all(len(payload) >= 15 for _, _, is_keyframe, payload in frames(900) if is_keyframe)


def test_simulated_streams_begin_with_a_keyframe_and_go_on_in_three_layers() -> None:
    first, *rest = frames(9)
    assert first[:3] == (0, 0, True)
    assert [layer for _, layer, _, _ in rest] == [2, 1, 2, 0, 2, 1, 2, 0]
    assert [sequence for sequence, *_ in rest] == list(range(1, 9))


def test_simulated_keyframes_come_every_ten_seconds_and_soon_after_a_request() -> None:
    traffic = Traffic(random.Random(7))
    times_s = []
    for index in range(700):
        if index == 60:
            traffic.request_keyframe()
        if traffic.next_frame(index * STEP_US)[2]:
            times_s.append(index * STEP_US / 1e6)
    assert times_s[0] == 0
    assert times_s[1] == pytest.approx(2.0, abs=KEYFRAME_PAUSE_S)
    assert times_s[2] - times_s[1] == pytest.approx(KEYFRAME_INTERVAL_S, abs=0.2)


def test_simulated_frames_are_frames_of_the_protocol() -> None:
    kinds: Counter[int] = Counter()
    for sequence, layer, is_keyframe, payload in frames(40):
        frame = Frame(
            stream=1,
            sequence=sequence,
            captured_us=5,
            payload=payload,
            layer=layer,
            is_keyframe=is_keyframe,
        )
        assert decode_media(media_message([encode_frame(frame)])) == [frame]
        kinds[layer + (FLAG_KEYFRAME << 8 if is_keyframe else 0)] += 1
    assert len(kinds) == 4


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
