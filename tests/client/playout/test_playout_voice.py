"""A face that is led by its voice: the moment that is heard is the moment that is shown."""

import pytest

from helpers.playout_trial import face
from pica_client.playout.buffer import MAX_LAG_S, Playout
from pica_protocol.frames import Frame

pytestmark = pytest.mark.unit

FRAME_S, OFFSET_US, WAY_S = 1 / 30, 3_000_000_000, 0.02


def receive(playout: Playout, index: int, late_s: float = 0.0) -> None:
    captured_us = OFFSET_US + round(index * FRAME_S * 1e6)
    frame = Frame(stream=1, sequence=index, captured_us=captured_us, payload=b"")
    playout.receive(frame, face(float(index)), index * FRAME_S + WAY_S + late_s)


def shown_s(playout: Playout, now: float, heard_s: float | None) -> float:
    """The moment shown, seconds of the sender's clock since the first frame."""
    heard_us = None if heard_s is None else OFFSET_US + round(heard_s * 1e6)
    played = playout.sample_at(now, heard_us)
    assert played is not None
    return (played.captured_us - OFFSET_US) / 1e6


def test_a_face_waits_for_the_voice_that_is_heard():
    playout = Playout()
    for index in range(90):
        receive(playout, index)
        now = index * FRAME_S + WAY_S
        if index > 5:
            shown = shown_s(playout, now, now - 0.12)
    assert shown == pytest.approx(now - 0.12, abs=0.002)


def test_a_face_goes_as_fast_as_a_stretched_voice_and_never_ahead_of_it():
    playout = Playout()
    heard_s = 0.0
    for index in range(120):
        receive(playout, index)
        now = index * FRAME_S + WAY_S
        heard_s += FRAME_S * (1.4 if 60 <= index < 75 else 1.0)
        if index == 10:
            heard_s = now - 0.3
        if index > 20:
            assert -0.045 <= shown_s(playout, now, heard_s) - heard_s <= 0.002


def test_a_face_whose_frames_are_late_falls_behind_its_voice_and_catches_up_without_a_snap():
    playout = Playout()
    steps = []
    before = None
    for index in range(200):
        now = index * FRAME_S + WAY_S
        if index >= 100 and index < 110:
            pass  # frames stop, the voice goes on
        elif index == 110:
            for each in range(100, 111):
                receive(playout, each, (110 - each) * FRAME_S)
        else:
            receive(playout, index)
        if index > 20:
            played = playout.sample_at(now, OFFSET_US + round((now - 0.12) * 1e6))
            assert played is not None
            value = float(played.sample.latent.ravel()[0])
            if before is not None and index > 40:
                steps.append(abs(value - before))
            before = value
    assert shown_s(playout, now, now - 0.12) == pytest.approx(now - 0.12, abs=MAX_LAG_S)
    assert max(steps) < 8  # ten frames are missing: it never jumps over them at once


def test_a_voice_of_another_clock_does_not_lead():
    playout = Playout()
    for index in range(60):
        receive(playout, index)
        now = index * FRAME_S + WAY_S
        if index > 5:
            shown = shown_s(playout, now, -500.0)
    assert shown == pytest.approx(now - WAY_S, abs=0.06)
