"""Streams that begin again and stray frames, from the wire to the decoded face."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
import pytest

from helpers.stream_toy import Sent, perform, toy_profile
from pica_client.playout.sender_clock import SenderClock
from pica_client.playout.transit import RESTART_FRAMES
from pica_core.codec.latent_sample import DecodedFrame
from pica_core.codec.latent_stream import LatentDecoder
from pica_protocol.frames import Frame

pytestmark = pytest.mark.unit

FRAME_S = 1 / 30
CLOCK_US = 1_000_000_000
"""The sender's clock at its first frame; those of its former lives may lie before it."""


class Receiving:
    """A decoder behind a sender's clock; a frame arrives every thirtieth of a second."""

    def __init__(self) -> None:
        self.clock = SenderClock()
        self.decoder = LatentDecoder(toy_profile())
        self.now = 100.0

    def deliver(self, frame: Sent) -> list[DecodedFrame]:
        self.now += FRAME_S
        wire = Frame(
            stream=1,
            sequence=frame.sequence,
            captured_us=CLOCK_US + frame.captured_us,
            payload=frame.payload,
        )
        passed = self.clock.receive(wire, self.now)
        shown = [each.decoded(self.decoder.decode(each.payload)) for each in passed]
        return [dataclasses.replace(f, captured_us=f.captured_us - CLOCK_US) for f in shown]

    def deliver_all(self, frames: Iterable[Sent]) -> list[DecodedFrame]:
        return [face for frame in frames for face in self.deliver(frame)]


def assert_shown_is_true(shown: Iterable[DecodedFrame], sent: Iterable[Sent]) -> None:
    truth = {frame.sequence: frame for frame in sent}
    for face in shown:
        frame = truth[face.number % 65536]
        assert face.captured_us == frame.captured_us
        np.testing.assert_array_equal(face.sample.latent, frame.decoded().sample.latent)


@pytest.mark.parametrize("lived", [1, 17, 300])
@pytest.mark.parametrize("clock_us", [100_000_000, -5_000_000])
def test_a_stream_that_begins_again_is_shown_whole(lived: int, clock_us: int) -> None:
    # As when a sender's connection is new and its count begins at 0; its clock goes on, or, on
    # another machine, is any other.
    old = perform(seed=1, num_frames=lived)
    new = [
        dataclasses.replace(frame, captured_us=frame.captured_us + clock_us)
        for frame in perform(seed=2, num_frames=400)
    ]
    receiving = Receiving()
    assert len(receiving.deliver_all(old)) == lived
    shown = receiving.deliver_all(new)
    assert len(shown) == len(new)
    assert_shown_is_true(shown, new)


@pytest.mark.parametrize("ahead", [RESTART_FRAMES + 1, 20_000, 32_767, 40_000])
def test_one_stray_frame_from_far_away_ends_nothing(ahead: int) -> None:
    sent = perform(num_frames=60)
    stray = perform(seed=9, num_frames=1, first_number=30 + ahead)[0]
    receiving = Receiving()
    shown = receiving.deliver_all(sent[:30])
    assert receiving.deliver(stray) == []
    shown += receiving.deliver_all(sent[30:])
    assert len(shown) == 60
    assert_shown_is_true(shown, sent)


def test_a_leap_of_the_count_goes_on_with_the_next_frame() -> None:
    # Cut off for a minute: the count went on without us.
    sent = perform(num_frames=30)
    later = perform(seed=2, num_frames=30, first_number=5000)
    receiving = Receiving()
    shown = receiving.deliver_all(sent) + receiving.deliver_all(later)
    assert len(shown) == 60
    assert_shown_is_true(shown, [*sent, *later])


def frame(number: int, captured_s: float) -> Frame:
    captured_us = CLOCK_US + round(captured_s * 1e6)
    return Frame(stream=1, sequence=number % 65536, captured_us=captured_us, payload=b"")


def test_numbers_go_on_across_the_wrap_and_leap_where_the_sender_begins_anew() -> None:
    clock = SenderClock()
    numbers = [clock.receive(frame(n, n / 30), n / 30)[0].number for n in range(65_534, 65_540)]
    assert numbers == list(range(65_534, 65_540))
    now, passed = 65_540 / 30, []
    for index in range(3):
        passed = clock.receive(frame(index, now + index / 30), now + index / 30)
        assert len(passed) == (3 if index == 2 else 0)
    assert [received.number % 65536 for received in passed] == [0, 1, 2]
    assert passed[0].number > 65_539 + RESTART_FRAMES
    assert clock.num_jumps == 1
