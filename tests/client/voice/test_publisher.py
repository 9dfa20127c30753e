"""A voice on its way out: two frames in a packet, none lost by a mute, none across a hole."""

import numpy as np
import pytest

from pica_client.voice import opus
from pica_client.voice.packet import FRAME_SAMPLES, FRAME_US, VoicePacket, decode_payload
from pica_client.voice.publisher import VoicePublisher
from pica_client.voice.source import SoundSource
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
        self.packets: list[VoicePacket] = []

    def describe(self, key: str, value: str) -> None:
        """Nobody listens."""

    def send_frame(self, payload: bytes, captured_us: int, *, track: Track) -> bool:
        """Keep the packet."""
        self.packets.append(decode_payload(len(self.packets), captured_us, payload))
        return True


def sent(frames: list[int], *, muted_from: int = 1 << 30) -> list[tuple[int, int, bool]]:
    """When each packet was captured, in frames, how many it holds, and whether it is a first."""
    link, publisher, decoder = (
        OpenLink(),
        VoicePublisher(SoundSource(LOUD)),
        opus.OpusDecoder(),
    )
    for index in frames:
        publisher.is_muted = index >= muted_from
        publisher.send(link, LOUD, index * FRAME_US)  # type: ignore[arg-type]
    return [
        (
            packet.captured_us // FRAME_US,
            len(decoder.decode(packet.payload)) // FRAME_SAMPLES,
            packet.is_first,
        )
        for packet in link.packets
    ]


def test_two_frames_share_a_packet() -> None:
    assert sent(list(range(6))) == [(0, 2, True), (2, 2, False), (4, 2, False)]


def test_frames_on_both_sides_of_a_hole_do_not_share_a_packet() -> None:
    assert sent([0, 1, 2, 10, 11]) == [(0, 2, True), (2, 1, False), (10, 2, True)]


@pytest.mark.parametrize(("muted_from", "last"), [(3, (2, 2, False)), (4, (4, 1, False))])
def test_a_mute_sends_the_frame_that_waits_for_another(
    muted_from: int, last: tuple[int, int, bool]
) -> None:
    assert sent(list(range(9)), muted_from=muted_from)[-1] == last
