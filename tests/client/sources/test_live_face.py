"""Samples that arrive when they arrive become a face that moves evenly, holds and rests."""

import numpy as np
import pytest

from pica_client.sources.calibration import Calibration
from pica_client.sources.live_face import EASE_S, HOLD_S, MAX_DELAY_S, LiveFace, TrackerSample
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit

JAW = ARKIT_INDEX["jawOpen"]
STEP_S = 1 / 60


def values(**shapes: float) -> FloatArray:
    arkit = np.zeros(NUM_ARKIT, np.float32)
    for name, value in shapes.items():
        arkit[ARKIT_INDEX[name]] = value
    return arkit


def feed(face: LiveFace, begin: int, end: int, *, clock_s: float = 1000, **shapes: float) -> None:
    for index in range(begin, end):
        tracker_s = index * STEP_S
        sample = TrackerSample(tracker_s=clock_s + tracker_s, arkit=values(**shapes))
        face.push(sample, tracker_s + 0.01)


def test_a_steady_movement_stays_steady_however_its_samples_arrive() -> None:
    face, rng = LiveFace(), np.random.default_rng(1)
    ramp, seen, pending = 0.2, [], []
    for index in range(240):
        tracker_s = index * STEP_S
        sample = TrackerSample(tracker_s=50 + tracker_s, arkit=values(jawOpen=ramp * tracker_s))
        pending.append((tracker_s + 0.005 + 0.03 * float(rng.random()), sample))
    pending.sort(key=lambda pair: pair[0])
    for tick in range(110):
        now = 0.2 + tick / 30
        while pending and pending[0][0] <= now:
            arrived_s, sample = pending.pop(0)
            face.push(sample, arrived_s)
        seen.append(face.face_at(now))

    times_s = np.array([each.captured_us for each in seen[30:]]) / 1e6
    jaw = np.array([each.arkit[JAW] for each in seen[30:]])
    slopes = np.diff(jaw) / np.diff(times_s)
    assert np.quantile(np.abs(slopes / ramp - 1), 0.9) < 0.1
    assert 0 < face.delay_s <= MAX_DELAY_S


def test_a_lost_face_holds_eases_to_rest_and_is_gone() -> None:
    face = LiveFace()
    feed(face, 0, 60, jawOpen=0.5)
    end_s = 59 * STEP_S + face.delay_s
    held = face.face_at(end_s + 0.9 * HOLD_S).arkit[JAW]
    half = face.face_at(end_s + HOLD_S + 0.5 * EASE_S)
    gone = face.face_at(end_s + HOLD_S + 1.1 * EASE_S)
    assert held == pytest.approx(0.5, abs=0.02)
    assert half.has_face
    assert half.arkit[JAW] == pytest.approx(0.25, abs=0.03)
    assert not gone.has_face


def test_a_face_that_comes_back_does_not_snap() -> None:
    face = LiveFace()
    feed(face, 0, 60, jawOpen=0.0)
    face.face_at(1.0)
    feed(face, 180, 240, jawOpen=1.0)
    jaw = [float(face.face_at(3.0 + tick / 60).arkit[JAW]) for tick in range(60)]
    assert max(np.diff(jaw)) < 0.1
    assert jaw[-1] == pytest.approx(1.0, abs=0.02)


def test_a_tracker_whose_clock_is_set_anew_goes_on() -> None:
    face = LiveFace()
    feed(face, 0, 60, jawOpen=0.1)
    feed(face, 60, 120, clock_s=0, jawOpen=0.6)
    assert face.face_at(2.0).arkit[JAW] == pytest.approx(0.6, abs=0.02)


@pytest.mark.parametrize("pace", [0.5, 0.88, 1.1])
def test_a_tracker_that_counts_frames_and_makes_fewer_is_not_lost(pace: float) -> None:
    face, lost = LiveFace(), 0
    for index in range(900):
        arrived_s = index * STEP_S / pace
        sample = TrackerSample(tracker_s=index * STEP_S, arkit=values(jawOpen=0.5))
        face.push(sample, arrived_s)
        lost += not face.face_at(arrived_s + 0.01).has_face
    assert lost <= 1
    assert face.face_at(arrived_s + 0.02).arkit[JAW] == pytest.approx(0.5, abs=0.02)


def test_a_head_moves_about_its_seat_no_further_than_a_seat_allows() -> None:
    face, seen = LiveFace(), []
    for index in range(120):
        where = [0.3, 0.0, -0.6] if index < 60 else [0.36, -0.5, -0.6]
        sample = TrackerSample(
            tracker_s=index * STEP_S, arkit=values(), place_m=np.array(where, np.float32)
        )
        face.push(sample, index * STEP_S + 0.01)
        seen.append(face.face_at(index * STEP_S + 0.02).translation_m)
    assert np.abs(seen[59]).max() < 1e-6  # where the chair stands is the seat
    assert seen[90][0] == pytest.approx(0.06, abs=0.01)
    assert seen[90][1] == pytest.approx(-0.10, abs=0.01)
    assert np.abs(np.diff(seen, axis=0)).max() < 0.06  # smoothed, not a snap
    assert seen[119][0] < seen[90][0]  # the seat follows


def test_gaze_rests_while_both_eyes_are_closed() -> None:
    face, gaze = LiveFace(), ARKIT_INDEX["eyeLookUpLeft"]
    feed(face, 0, 30, eyeLookUpLeft=0.4)
    feed(face, 30, 60, eyeLookUpLeft=1.0, eyeBlinkLeft=1.0, eyeBlinkRight=1.0)
    assert face.face_at(60 * STEP_S).arkit[gaze] < 0.5


def test_a_blink_keeps_its_depth_through_the_filter() -> None:
    face, depths = LiveFace(), []
    shape = np.sin(np.linspace(0, np.pi, 10)) ** 2  # 160 ms
    for index in range(60):
        blink = shape[index - 30] if 30 <= index < 40 else 0.0
        sample = TrackerSample(tracker_s=index * STEP_S, arkit=values(eyeBlinkLeft=blink))
        face.push(sample, index * STEP_S)
        depths.append(float(face.face_at(index * STEP_S).arkit[ARKIT_INDEX["eyeBlinkLeft"]]))
    assert max(depths) > 0.9


def test_an_offset_person_rests_and_still_blinks() -> None:
    rest = values(eyeSquintLeft=0.2, mouthSmileLeft=0.2, eyeBlinkLeft=0.1, eyeBlinkRight=0.1)
    calibration = Calibration(
        neutral=tuple(rest.tolist()), lid_open=(0.1, 0.1), lid_closed=(0.8, 0.8)
    )
    at_rest = calibration.apply(rest)
    assert np.abs(at_rest).max() < 1e-6
    closed = rest.copy()
    closed[[ARKIT_INDEX["eyeBlinkLeft"], ARKIT_INDEX["eyeBlinkRight"]]] = 0.8
    assert calibration.apply(closed)[ARKIT_INDEX["eyeBlinkLeft"]] == pytest.approx(1)
    smiling = rest.copy()
    smiling[ARKIT_INDEX["mouthSmileLeft"]] = 1.0
    assert calibration.apply(smiling)[ARKIT_INDEX["mouthSmileLeft"]] == pytest.approx(1)
