"""A face before a camera: the page sees in a picture what Python sees, and makes the same of it."""

import numpy as np
import pytest
from PIL import Image

from helpers.face_networks import face_file
from helpers.page import Handle, Page
from pica_client.sources.calibration import calibrate
from pica_client.sources.live_face import Seat, Smoother
from pica_client.sources.webcam import FaceFinder, head_pose
from pica_core.face_networks import TABLE, load_networks
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit


def test_a_face_is_seen_as_by_python(page: Page) -> None:
    path = face_file()
    data = pytest.importorskip("skimage.data")
    finder = FaceFinder(load_networks(path))
    own: Handle = page.call("finder", "FaceFinder", path.read_bytes(), TABLE)
    whole = Image.fromarray(data.astronaut())
    # Found anywhere, followed, turned and found again, lost.
    pictures = [
        whole,
        whole.transform(whole.size, Image.Transform.AFFINE, (1, 0, 8, 0, 1, 3)),
        whole.rotate(-25).resize((320, 240)),
        Image.new("RGB", (320, 240)),
    ]
    for picture in pictures:
        sample = finder.find(picture, None)
        width, height = picture.size
        pixels = np.asarray(picture.convert("RGBA")).tobytes()
        found = own.find({"data": pixels, "width": width, "height": height})
        if not sample.has_face:
            assert found is None
            continue
        assert found[:52] == pytest.approx(sample.arkit, abs=2e-3)
        assert found[52:55] == pytest.approx(sample.rotation, abs=5e-4)
        assert found[55:] == pytest.approx(sample.place_m, abs=1e-4)


def test_a_head_turns_as_pythons_does(page: Page) -> None:
    rng = np.random.default_rng(1)
    landmarks = rng.uniform(100, 300, (478, 3)).astype(np.float32)
    for index, (x, y, z) in TABLE["head"].items():
        landmarks[int(index)] = (320 + 90 * x + 20 * z, 200 - 80 * y + 30 * x, -80 * z + 40 * x)
    rotation, place_m = head_pose(landmarks, 640, 480)
    points = [each.tolist() for each in landmarks]
    found = page.call("finder", "headPose", points, TABLE["head"], 640, 480)
    assert found == pytest.approx([*rotation, *place_m], abs=1e-4)


def test_a_face_becomes_calm_and_ones_own_as_in_python(page: Page) -> None:
    rng = np.random.default_rng(3)
    faces = np.abs(rng.normal(0.3, 0.2, (150, 58))).astype(np.float32)
    faces[60:112, [0, 7]] = 0.7  # as far as a camera sees them close
    times_s = np.cumsum(rng.uniform(0.02, 0.06, len(faces)))
    tracking: Handle = page.call("live_face", "Tracking")
    smoother, seat = Smoother(), Seat()
    at_rest: list[FloatArray] = []
    eyes_closed: list[FloatArray] = []
    wishes = {tracking.wish()}
    for face, at_s, step_s in zip(faces, times_s, np.diff(times_s, prepend=-1), strict=True):
        since_s = at_s - times_s[0]
        if since_s < 1.5:
            at_rest.append(face[:52])
        elif 2.5 <= since_s < 4.5:
            eyes_closed.append(face[:52])
        arkit = calibrate(at_rest, eyes_closed).apply(face[:52])
        offset_m = seat.offset_m(face[55:], min(step_s, 0.2))
        pose = np.concatenate((arkit, face[52:55], offset_m))
        expected = smoother.smooth(pose, min(step_s, 0.2))
        assert tracking.push(face, float(at_s)) == pytest.approx(expected, abs=1e-5)
        wishes.add(tracking.wish())
    assert len(wishes) == 3
    assert len(eyes_closed) > 30


def test_eyes_that_did_not_close_keep_the_usual_level(page: Page) -> None:
    tracking: Handle = page.call("live_face", "Tracking")
    face = np.zeros(58, np.float32)
    face[[0, 7]] = 0.3
    for number in range(60):
        tracking.push(face, number / 10)
    blink = face.copy()
    blink[[0, 7]] = 1.0
    for number in range(60, 70):
        seen = tracking.push(blink, number / 10)
    assert seen[0] == pytest.approx(1, abs=1e-3)
