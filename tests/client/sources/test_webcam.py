"""A webcam: its networks on a real face and on drawn ones, its camera, its bad days."""

import hashlib
import itertools
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import ExifTags, Image, ImageOps
from scipy.spatial.transform import Rotation

from helpers.face_networks import face_networks
from pica_client.errors import SourceError
from pica_client.sources import webcam
from pica_client.sources.live_face import TrackerSample, rotation_vector_from_yaw_pitch_roll
from pica_client.sources.registry import open_source
from pica_client.sources.webcam import _HEAD as HEAD
from pica_client.sources.webcam import _INDICES as INDICES
from pica_client.sources.webcam import UNIT_M, FaceFinder, Webcam, head_pose, open_camera, pictures
from pica_core import face_networks as model
from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.errors import FaceNetworksError
from pica_core.face_networks import FaceNetworks
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit


@pytest.fixture(scope="module")
def networks() -> FaceNetworks:
    return face_networks()


@pytest.fixture(scope="module")
def astronaut() -> Image.Image:
    """Eileen Collins, photographed by NASA: public domain."""
    data = pytest.importorskip("skimage.data")
    return Image.fromarray(data.astronaut())


def value(sample: TrackerSample, name: str) -> float:
    return float(sample.arkit[ARKIT_INDEX[name]])


def test_a_real_smile_is_seen_as_by_mediapipe(
    networks: FaceNetworks, astronaut: Image.Image
) -> None:
    finder = FaceFinder(networks)
    for _ in range(2):
        sample = finder.find(astronaut, 0.0)
        # MediaPipe 0.10 says of this picture:
        for name, said in {
            "mouthSmileLeft": 0.898,
            "mouthSmileRight": 0.896,
            "mouthUpperUpLeft": 0.556,
            "mouthUpperUpRight": 0.539,
            "eyeSquintLeft": 0.392,
            "eyeSquintRight": 0.264,
        }.items():
            assert value(sample, name) == pytest.approx(said, abs=0.1), name
    assert sample.place_m is not None
    assert -3 < sample.place_m[2] < -0.3


def test_a_face_leaves_and_comes_back(networks: FaceNetworks, astronaut: Image.Image) -> None:
    finder, nobody = FaceFinder(networks), Image.new("RGB", astronaut.size, (90, 90, 90))
    shown = [astronaut, nobody, nobody, astronaut]
    assert [finder.find(each, None).has_face for each in shown] == [True, False, False, True]


def test_the_larger_of_two_faces_is_followed(
    networks: FaceNetworks, astronaut: Image.Image
) -> None:
    head = astronaut.crop((120, 10, 340, 250))
    both = Image.new("RGB", (440, 300), (60, 60, 60))
    both.paste(head, (210, 30))
    both.paste(head.resize((154, 168)), (20, 60))
    finder = FaceFinder(networks)
    assert finder.find(both, None).has_face
    assert finder.landmarks is not None
    assert finder.landmarks[:, 0].mean() > 220
    assert len(networks.detect(both)) == 2


def drawn(head: FloatArray, rotation: FloatArray, width: int, height: int) -> FloatArray:
    """Landmarks of a turned head as the network would give them: 100 pixels a unit."""
    landmarks = np.zeros((478, 3), np.float32)
    placed = Rotation.from_rotvec(rotation).apply(head) * 100
    landmarks[INDICES] = placed * [1, -1, -1 / 0.8] + [width / 2 + 90, height / 2 - 60, 0]
    return landmarks


@pytest.mark.parametrize("degrees", [(0, 0, 0), (25, 0, 0), (0, -15, 0), (0, 0, 20), (20, 10, -8)])
def test_a_head_is_turned_and_placed_as_one_that_looks_at_the_camera(
    degrees: tuple[float, float, float],
) -> None:
    true = rotation_vector_from_yaw_pitch_roll(np.radians([degrees]))[0]
    rotation, place_m = head_pose(drawn(HEAD, true, 640, 480), 640, 480)
    np.testing.assert_allclose(rotation, true, atol=1e-3)
    # A unit of 100 pixels at a focal length of 576 is 5.76 units away.
    assert place_m[2] == pytest.approx(-5.76 * UNIT_M, rel=0.01)
    assert place_m[0] > 0  # the picture's right is the subject's left
    assert place_m[1] > 0


@pytest.fixture
def video(tmp_path: Path, astronaut: Image.Image) -> Path:
    """A second of the astronaut, and of nobody."""
    av = pytest.importorskip("av")
    path = tmp_path / "face.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=20)
        stream.width, stream.height = 320, 320
        for number in range(20):
            image = astronaut.resize((320, 320)) if number < 12 else Image.new("RGB", (320, 320))
            for packet in stream.encode(av.VideoFrame.from_image(image)):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return path


@pytest.mark.slow
def test_a_video_stands_in_for_a_camera(networks: FaceNetworks, video: Path) -> None:
    seen: list[TrackerSample] = []
    camera = Webcam(str(video), networks, tap=lambda sample, arrived: seen.append(sample))
    with closing(camera):
        assert camera.trouble
        deadline_s = time.monotonic() + 20
        while len(seen) < 26 and time.monotonic() < deadline_s:
            time.sleep(0.05)
        preview = camera.preview()
    assert preview is not None
    assert preview.shape == (320, 320, 3)
    faces = [sample.has_face for sample in seen[:26]]
    assert faces[:10] == [True] * 10
    assert not any(faces[13:19])
    assert any(faces[20:])  # it begins again
    assert np.all(np.diff([sample.tracker_s or 0.0 for sample in seen]) > 0)


def decoded(image: Image.Image, time_s: float, rotation: int = 0) -> SimpleNamespace:
    """A picture as a container gives it."""
    size = {"width": image.width, "height": image.height}
    told = {"time": time_s, "rotation": rotation, "side_data": {}}
    return SimpleNamespace(**size, **told, to_image=lambda **_: image.copy())


def test_a_film_is_shown_upright_and_from_its_first_picture() -> None:
    wide = Image.new("RGB", (8, 4))
    wide.putpixel((0, 0), (255, 0, 0))
    film = [decoded(wide, time_s, rotation=-90) for time_s in (7200, 7201)]
    container = SimpleNamespace(name="", decode=lambda video: iter(film))
    waits: list[float] = []
    shown = pictures(container, True, lambda seconds: waits.append(seconds) or len(waits) == 3)
    (first, first_s), (_, second_s) = next(shown), next(shown)
    assert first.size == (4, 8)
    assert first.getpixel((3, 0)) == (255, 0, 0)  # a quarter turn clockwise
    assert (first_s, second_s) == (0.0, 1.0)
    assert waits[0] < 0.5


def test_a_film_whose_clock_jumps_goes_on() -> None:
    pytest.importorskip("av")
    times_s = (5.0, 5.1, 9000.0, 9000.1, 3.0, 3.1)
    film = [decoded(Image.new("RGB", (8, 8)), time_s) for time_s in times_s]
    container = SimpleNamespace(name="", decode=lambda video: iter(film))
    shown = itertools.islice(pictures(container, True, lambda seconds: seconds > 1), 6)
    usual_s = 1 / 30
    steps_s = np.diff([time_s or 0.0 for _, time_s in shown])
    assert steps_s == pytest.approx([0.1, usual_s, 0.1, usual_s, 0.1])


def test_a_film_in_which_a_stream_begins_later_is_shown_as_far_as_it_is_read() -> None:
    pytest.importorskip("av")

    def decode(video: int) -> Iterator[SimpleNamespace]:
        yield decoded(Image.new("RGB", (8, 8)), 0.5)
        raise IndexError("list index out of range")

    container = SimpleNamespace(name="", decode=decode, seek=lambda offset: None)
    assert len(list(itertools.islice(pictures(container, True, lambda seconds: False), 3))) == 3


def test_a_film_of_which_nothing_can_be_shown_ends() -> None:
    av = pytest.importorskip("av")

    def to_image(threads: int) -> None:
        raise av.InvalidDataError(0, "damaged")

    film = [SimpleNamespace(time=0.0, to_image=to_image)]
    container = SimpleNamespace(name="", decode=lambda video: film, seek=lambda offset: None)
    assert not list(pictures(container, True, lambda seconds: pytest.fail("waits for nothing")))


def test_a_picture_too_large_is_not_decoded(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    Image.new("L", (4096, 2305)).save(path := tmp_path / "large.png")
    with closing(open_camera(str(path))) as container, pytest.raises(av.FFmpegError):
        next(container.decode(video=0))


@pytest.mark.skipif(sys.platform != "linux", reason="counts threads of libraries, too")
def test_pictures_leave_no_threads(video: Path) -> None:
    with closing(open_camera(str(video))) as container:
        shown = pictures(container, True, lambda seconds: False)
        counts = [len(os.listdir("/proc/self/task")) for _ in itertools.islice(shown, 5)]
    assert counts[4] == counts[0]


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_photo_is_shown_as_its_camera_was_held_again_and_again(
    tmp_path: Path, orientation: int
) -> None:
    pytest.importorskip("av")
    exif, path = Image.Exif(), tmp_path / "photo.jpg"
    exif[ExifTags.Base.Orientation] = orientation
    stored = Image.new("RGB", (96, 48), (40, 40, 40))
    stored.paste((230, 30, 30), (0, 0, 48, 16))
    stored.save(path, exif=exif)

    container = open_camera(str(path))
    shown = list(itertools.islice(pictures(container, True, lambda seconds: False), 3))
    container.close()

    with Image.open(path) as photo:
        wanted = np.asarray(ImageOps.exif_transpose(photo).convert("RGB"), np.int64)
    for picture, _ in shown:
        assert np.abs(np.asarray(picture, np.int64) - wanted).mean() < 3
    assert len(shown) == 3


class Blank:
    """Stands in for a finder, and sees nobody."""

    landmarks = None

    def __init__(self, networks: FaceNetworks) -> None:
        pass

    def find(self, picture: Image.Image, time_s: float | None) -> TrackerSample:
        return TrackerSample(tracker_s=time_s, has_face=False)


class Film:
    """A container of one picture, which is then held for some time; it cannot be rewound."""

    name = ""

    def __init__(self, hold: Callable[[], object] = lambda: None) -> None:
        self._is_over, self._hold = False, hold

    def decode(self, video: int) -> Iterator[SimpleNamespace]:
        if not self._is_over:
            self._is_over = True
            yield decoded(Image.new("RGB", (8, 8)), 0.5)
            self._hold()

    def seek(self, offset: int) -> None:
        import av

        raise av.FFmpegError(1, "Operation not permitted")

    def close(self) -> None:
        pass


def test_a_reader_that_fails_says_so_and_reads_on(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("av")
    fails, is_seen, reads_on = threading.Event(), threading.Event(), threading.Event()

    class Broken(Blank):
        def find(self, picture: Image.Image, time_s: float | None) -> TrackerSample:
            if not fails.is_set():
                raise ValueError("no memory")
            reads_on.set()
            return super().find(picture, time_s)

    def reopen(device: str) -> Film:
        fails.set()
        is_seen.wait(20)
        return Film()

    monkeypatch.setattr(webcam, "open_camera", lambda device: Film())
    monkeypatch.setattr(webcam, "FaceFinder", Broken)
    monkeypatch.setattr(webcam, "REOPEN_S", 0.5)
    with closing(Webcam("7", None)) as camera:
        monkeypatch.setattr(webcam, "open_camera", reopen)
        assert fails.wait(20)
        assert camera.trouble.endswith("7 cannot be read: no memory")
        is_seen.set()
        assert reads_on.wait(20)


def test_a_camera_that_stands_still_holds_nobody_up(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("av")
    goes_on = threading.Event()
    monkeypatch.setattr(webcam, "open_camera", lambda device: Film(goes_on.wait))
    monkeypatch.setattr(webcam, "FaceFinder", Blank)
    closer = threading.Thread(target=Webcam("7", None).close, daemon=True)
    closer.start()
    closer.join(timeout=20)
    is_held = closer.is_alive()
    goes_on.set()
    assert not is_held


@pytest.fixture
def nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine that has no networks yet."""
    path = tmp_path / "models" / "face_landmarker.task"
    monkeypatch.setattr(model, "model_path", lambda: path)
    return path


def test_without_its_networks_a_webcam_says_what_to_do(nowhere: Path) -> None:
    with pytest.raises(SourceError, match="pica webcam setup"):
        open_source("webcam")


def test_nothing_but_the_very_file_is_taken(
    nowhere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong = tmp_path / "face_landmarker.task"
    wrong.write_bytes(b"something else")
    with pytest.raises(FaceNetworksError, match="is not the face landmarker: its SHA-256"):
        model.install(str(wrong))
    with pytest.raises(FaceNetworksError, match="No such file"):
        model.install(str(tmp_path / "none.task"))
    assert not nowhere.exists()
    monkeypatch.setattr(model, "SHA256", hashlib.sha256(b"something else").hexdigest())
    assert model.install(str(wrong)) == nowhere
    assert nowhere.read_bytes() == b"something else"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.mp4", None, "neither a camera nor a file|No such file"),
        ("garbage.mp4", b"\x00garbage" * 300, "webcam: .*garbage.mp4"),
        ("cut.ogv", b"OggS" + bytes(60), "webcam: .*cut.ogv"),
    ],
)
def test_what_is_no_camera_is_said_to_be_none(
    tmp_path: Path, name: str, content: bytes | None, message: str
) -> None:
    pytest.importorskip("av")
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(SourceError, match=message):
        open_camera(str(tmp_path / name))
