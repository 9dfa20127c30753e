"""A voice on its way out: two frames in a packet, none lost by a mute, none across a hole."""

import numpy as np
import pytest

from pica_client.voice import opus
from pica_client.voice.opus import FRAME_SAMPLES, FRAME_US
from pica_client.voice.source import SoundSource, VoicePublisher
from pica_core.types import FloatArray
from pica_protocol.messages import Track

pytestmark = [
    pytest.mark.unit,
    pytest.mark.skipif(opus.available() is not None, reason="needs libopus"),
]

LOUD: FloatArray = np.random.default_rng(1).normal(0, 0.1, FRAME_SAMPLES).astype(np.float32)


class OpenLink:
    """Takes everything, as a link that has joined."""

    is_joined = True

    def __init__(self) -> None:
        self.packets: list[tuple[bytes, int]] = []

    def describe(self, key: str, value: str) -> None:
        """Nobody listens."""

    def send_frame(self, payload: bytes, captured_us: int, *, track: Track) -> bool:
        """Keep the packet."""
        self.packets.append((payload, captured_us))
        return True


def heard(frames: list[int], *, muted_from: int = 1 << 30) -> list[tuple[int, FloatArray]]:
    """When each packet was captured, in frames, and its sound."""
    link, publisher = OpenLink(), VoicePublisher(SoundSource(LOUD))
    decoder = opus.OpusDecoder()
    for index in frames:
        publisher.is_muted = index >= muted_from
        publisher.send(link, LOUD, index * FRAME_US)  # type: ignore[arg-type]
    return [(at_us // FRAME_US, decoder.decode(payload)) for payload, at_us in link.packets]


def sent(frames: list[int], *, muted_from: int = 1 << 30) -> list[tuple[int, int]]:
    """When each packet was captured, and how many frames it holds."""
    packets = heard(frames, muted_from=muted_from)
    return [(at, len(sound) // FRAME_SAMPLES) for at, sound in packets]


def test_two_frames_share_a_packet() -> None:
    assert sent(list(range(6))) == [(0, 2), (2, 2), (4, 2)]


def test_frames_on_both_sides_of_a_hole_do_not_share_a_packet() -> None:
    assert sent([0, 1, 2, 10, 11]) == [(0, 2), (2, 1), (10, 2)]


@pytest.mark.parametrize(("muted_from", "last"), [(3, (2, 2)), (4, (4, 1))])
def test_a_mute_sends_the_frame_that_waits_for_another(
    muted_from: int, last: tuple[int, int]
) -> None:
    assert sent(list(range(9)), muted_from=muted_from)[-1] == last


def test_nothing_of_what_is_said_after_a_mute_is_sent() -> None:
    _, (_, spoken), (_, muted) = heard(list(range(9)), muted_from=4)
    late = -FRAME_SAMPLES // 2  # before that the codec fades what came before
    assert np.std(muted[late:]) < 0.4 * np.std(spoken[late:])
