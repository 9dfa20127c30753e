"""Lips of a face that stands still go on by the voice, without a step at either seam."""

from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from pica_client.call.held_lips import FADE_S, WARM_PACKETS, HeldLips
from pica_client.voice import opus
from pica_client.voice.opus import OpusDecoder, OpusEncoder
from pica_client.voice.packet import FRAME_SAMPLES, FRAME_US, PACKET_FRAMES, VoicePacket
from pica_client.voice.wav import shipped_speech
from pica_core.avatar.file import load_avatar
from pica_core.types import FloatArray

pytestmark = [
    pytest.mark.unit,
    pytest.mark.skipif(opus.available() is not None, reason="needs libopus"),
]

AVATAR = load_avatar(Path(str(resources.files("pica_core"))) / "avatars" / "amara.pica")
FACE: FloatArray = np.random.default_rng(0).normal(0, 1, (8, 8, 4)).astype(np.float32)
PACKET_US, REFRESH_US = PACKET_FRAMES * FRAME_US, 20_000
AHEAD_US = 60_000
"""How much of a voice has come before it is heard, at least: packets and their buffer."""


class Display:
    """Shows a face whose frames end at a moment, and come again at another."""

    def __init__(self, lips: HeldLips, ahead_us: int = AHEAD_US) -> None:
        self.lips, self.now_us, self._ahead_us = lips, 0, ahead_us
        sound, encoder = shipped_speech(), OpusEncoder()
        size = PACKET_FRAMES * FRAME_SAMPLES
        self._packets = [
            VoicePacket(n, n * PACKET_US, encoder.encode(sound[n * size :][:size]) or b"\0")
            for n in range(100)
        ]
        self._num_sent = 0

    def run(self, until_us: int, held_us: int | None = None) -> list[tuple[FloatArray, int]]:
        """What is added to the face, and by how much its lips are off the voice."""
        shown = []
        while self.now_us < until_us:
            self.now_us += REFRESH_US
            while (self._num_sent + 1) * PACKET_US <= self.now_us + self._ahead_us:
                self.lips.receive("ada", self._packets[self._num_sent])
                self._num_sent += 1
            face_us = self.now_us if held_us is None else held_us
            now = 7.0 + self.now_us / 1e6
            latent, lips_us = self.lips.move("ada", AVATAR, FACE, face_us, self.now_us, now)
            shown.append((latent - FACE, lips_us - self.now_us))
        return shown


def test_a_face_that_moves_is_left_alone() -> None:
    shown = Display(HeldLips(OpusDecoder)).run(1_000_000)
    assert all(not added.any() and off_us == 0 for added, off_us in shown)


def test_lips_go_on_by_the_voice_in_step_and_without_a_step_at_the_seams() -> None:
    display = Display(HeldLips(OpusDecoder))
    display.run(600_000)
    held = display.run(1_600_000, held_us=600_000)
    again = display.run(1_600_000 + round(FADE_S * 1e6) + 40_000)
    assert all(abs(off_us) <= 40_000 for _, off_us in held)
    sizes = [float(np.abs(added).max()) for added, _ in held + again]
    assert max(sizes) > 0.3
    steps = np.abs(np.diff([np.ravel(added) for added, _ in held + again], axis=0)).max(axis=1)
    assert steps[:2].max() < 0.2 * max(sizes)
    assert steps[len(held) - 1 :].max() < 0.3 * max(sizes)
    assert sizes[-1] == 0.0


def test_lips_keep_step_up_to_the_end_of_what_has_come() -> None:
    display = Display(HeldLips(OpusDecoder), ahead_us=48_000)
    display.run(600_000)
    held = display.run(1_000_000, held_us=600_000)
    assert all(off_us == 0 for _, off_us in held[2:])


def test_it_forgets_who_left() -> None:
    lips = HeldLips(OpusDecoder)
    Display(lips).run(600_000)
    lips.keep({"ben"})
    assert lips.move("ada", AVATAR, FACE, 0, 500_000, 8.1) == (FACE, 0)


def test_hostile_packets_cost_neither_memory_nor_the_face() -> None:
    lips = HeldLips(OpusDecoder)
    for number in range(2 * WARM_PACKETS):
        lips.receive("ada", VoicePacket(number, 0, b"\xff" * 7))
    latent, lips_us = lips.move("ada", AVATAR, FACE, 0, 500_000, 1.0)
    assert lips_us == 0
    assert np.isfinite(latent).all()
