"""Photos and films of a person: what cannot be used, and a head whose truth is known."""

import json
import wave
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageFilter

from helpers.face_networks import face_networks
from helpers.heic import heic_of
from helpers.own_head import AZIMUTHS, SIDE, draw_person_from, write_film, write_photos
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.camera import Camera, look_at
from pica_core.capture.me.face import NERSEMBLE_FILMS, align, read_head
from pica_core.capture.me.film import choose_frames, spread_out
from pica_core.capture.me.nersemble import camera_films, read_films
from pica_core.capture.me.photos import (
    landmark_spots,
    photo_paths,
    read_photo,
    read_photos,
    size_of,
)
from pica_core.capture.me.pictured import fit_photos, unshaded
from pica_core.capture.me.solve import Sight, Solution, solve
from pica_core.capture.person.choices import NUM_MODES, read_model
from pica_core.cli import MeOptions, me
from pica_core.errors import CaptureError
from pica_core.types import ByteArray, Float64Array

pytestmark = pytest.mark.render

FOCAL = 900.0


def test_identity_focal_length_and_expressions_follow_from_landmarks() -> None:
    model, random = read_model(), np.random.default_rng(3)
    spots = landmark_spots(model)
    true = random.normal(0, 1, NUM_MODES)
    worn = np.zeros((7, NUM_ARKIT))
    worn[3, ARKIT_INDEX["jawOpen"]] = 0.4
    angles = zip((0, -45, 45, -22, 22, 10, -10), (0, 0, 0, 12, -12, 15, -15), strict=True)
    cameras = [_camera(azimuth, elevation) for azimuth, elevation in angles]
    exact = _solution(cameras, true, worn)
    sights = [
        Sight(
            pixels=camera.project(exact.points(spots, k))[0] + random.normal(0, 0.3, (478, 2)),
            precision=np.tile(np.eye(2), (478, 1, 1)),
        )
        for k, camera in enumerate(cameras)
    ]
    spots = replace(spots, offset_precision=1e8 * np.tile(np.eye(3), (478, 1, 1)))
    begun = [
        replace(camera, intrinsics=camera.intrinsics * [[1.2, 1, 1], [1, 1.2, 1], [1, 1, 1]])
        for camera in cameras
    ]
    start = _solution(begun, np.zeros(NUM_MODES), np.zeros_like(worn))
    found = solve(spots, sights, start, [(1.2 * FOCAL, 0.15)])
    assert abs(found.cameras[0].intrinsics[0, 0] / FOCAL - 1) < 0.03
    assert abs(found.expressions[3, ARKIT_INDEX["jawOpen"]] - 0.4) < 0.05
    assert found.expressions[:3].max() < 0.1
    shape, truth = found.shape(model)[::7], exact.shape(model)[::7]
    face = truth[:, 2] > 0.03
    placed = align(shape[face], truth[face], np.ones(face.sum()))
    apart = np.linalg.norm(placed.apply(shape[face]) - truth[face], axis=1)
    average = model.mean.rest_m[::7][face]
    mean = align(average, truth[face], np.ones(face.sum())).apply(average)
    assert np.median(apart) < 0.0005 < np.median(np.linalg.norm(mean - truth[face], axis=1))


def test_a_head_has_the_usual_size_or_that_of_its_pupils() -> None:
    """What landmarks are off by would be less in a smaller head; photos do not show a size."""
    model, random = read_model(), np.random.default_rng(4)
    spots = landmark_spots(model)
    cameras = [_camera(azimuth, 0) for azimuth in (-40, -20, 0, 20, 40)]
    exact = _solution(cameras, np.zeros(NUM_MODES), np.zeros((5, NUM_ARKIT)))
    off = random.normal(0, 0.003, (478, 3))
    sights = [
        Sight(
            pixels=camera.project(exact.points(spots, k) + off)[0],
            precision=np.tile(np.eye(2), (478, 1, 1)),
        )
        for k, camera in enumerate(cameras)
    ]
    found = solve(spots, sights, exact, [(FOCAL, 0.04)])
    mean, shape = model.mean.rest_m[::9], found.shape(model)[::9]
    assert abs(align(mean, shape, np.ones(len(mean))).scale - 1) < 0.02
    found = solve(spots, sights, exact, [(FOCAL, 0.04)], size=size_of(0.068))
    left, right = (eye.centre_m for eye in model.shaped(found.shape(model)).eyes)
    assert np.linalg.norm(left - right) == pytest.approx(0.068, abs=2e-4)
    assert align(mean, found.shape(model)[::9], np.ones(len(mean))).scale > 1.05


def test_a_fit_that_begins_far_off_comes_near() -> None:
    """A sharp portrait with a smile, cut out of a photo from afar: its lens is not a phone's."""
    model, random = read_model(), np.random.default_rng(5)
    spots, camera = landmark_spots(model), _camera(10, 0)
    smile = np.zeros((1, NUM_ARKIT))
    smile[0, [ARKIT_INDEX["mouthSmileLeft"], ARKIT_INDEX["mouthSmileRight"]]] = 0.9
    exact = _solution([camera], random.normal(0, 1, NUM_MODES), smile)
    pixels = camera.project(exact.points(spots, 0))[0]
    sight = Sight(pixels=pixels, precision=np.tile(900 * np.eye(2), (478, 1, 1)))
    begun = replace(
        camera,
        intrinsics=camera.intrinsics * [[0.4, 1, 1], [1, 0.4, 1], [1, 1, 1]],
        translation_m=camera.translation_m * [1, 1, 0.4],
    )
    start = _solution([begun], np.zeros(NUM_MODES), np.zeros((1, NUM_ARKIT)))
    found = solve(spots, [sight], start, [(0.4 * FOCAL, 0.15)], rounds=8, is_rough=True)
    apart = found.cameras[0].project(found.points(spots, 0))[0] - pixels
    assert np.median(np.linalg.norm(apart, axis=1)) < 0.3


def _camera(azimuth: float, elevation: float) -> Camera:
    a, e = np.radians([azimuth, elevation])
    away = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    middle = np.array([0.0, -0.02, 0.03])
    fov = 2 * np.arctan(SIDE / 2 / FOCAL)
    return look_at(
        centre_m=middle + 0.6 * away, target_m=middle, vertical_fov=fov, width=SIDE, height=SIDE
    )


def _solution(
    cameras: list[Camera], coefficients: Float64Array, expressions: Float64Array
) -> Solution:
    return Solution(
        coefficients=coefficients, expressions=expressions, cameras=tuple(cameras),
        offset_m=np.zeros((478, 3)), lens=np.zeros(len(cameras), int),
    )  # fmt: skip


def test_light_is_taken_off_and_brows_stay_dark() -> None:
    random = np.random.default_rng(6)
    slopes = random.normal(size=(20_000, 3)) * [1, 1, 0.5] + [0, 0, 1]
    slopes /= np.linalg.norm(slopes, axis=1, keepdims=True)
    light = 0.4 + 0.6 * np.maximum(slopes @ [0.5, 0.6, 0.62], 0)
    brow = slopes[:, 1] > 0.8  # also where it is brightest
    true = np.where(brow[:, None], 0.08, 1.0) * [0.5, 0.35, 0.25]
    found = unshaded(true * light[:, None], slopes, np.ones(len(slopes)))
    before, after = (np.std(np.log(each[~brow, 0])) for each in (true * light[:, None], found))
    assert after < 0.3 * before
    assert np.median(found[brow]) / np.median(found[~brow]) < 0.12
    assert np.median(found[~brow, 0]) == pytest.approx(0.5 * np.median(light[~brow]), rel=0.15)


def test_frames_are_the_sharpest_of_each_view_and_spread_from_the_front() -> None:
    views = np.radians([[0, 0], [1, 0], [30, 0], [31, 0], [-40, 5], [10, 0]])
    sharp = np.array([0.2, 0.3, 0.3, 0.2, 0.3, 0.1])
    assert spread_out(views, sharp) == [1, 4, 2, 5]


# Pictures of a drawn person


@pytest.fixture(scope="module")
def pictures() -> list[ByteArray]:
    """A drawn person from three sides, and a profile."""
    return draw_person_from(*AZIMUTHS, 100.0)


def darken_eyes(face: Image.Image) -> Image.Image:
    """A frontal face with sunglasses."""
    landmarks, _ = face_networks().landmarks(face, face_networks().detect(face)[0])
    for column, row in landmarks[[468, 473], :2]:
        ImageDraw.Draw(face).ellipse((column - 32, row - 26, column + 32, row + 26), (12, 12, 14))
    return face


Change = Callable[[Image.Image], Image.Image]


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("cmyk.jpg", lambda face: face.convert("CMYK"), "pixels are CMYK; save it with 8 bits"),
        ("deep.png", lambda face: face.convert("I;16"), "pixels are I;16; save it with 8 bits"),
        ("grey.png", lambda face: Image.new("RGB", face.size, "grey"), "no face is found"),
        ("blurred.jpg", lambda face: face.filter(ImageFilter.GaussianBlur(9)), "blurred"),
        ("pair.png", lambda face: Image.fromarray(np.hstack([face, face])), "two people"),
        ("sunglasses.png", lambda face: darken_eyes(face), "the eyes are dark; take sunglasses"),
        ("cut.png", lambda face: face.crop((0, 330, SIDE, SIDE)), "cut off|no face"),
    ],
)
def test_a_photo_that_is_of_no_use_is_named_with_a_remedy(
    tmp_path: Path, pictures: list[ByteArray], name: str, change: Change, message: str
) -> None:
    change(Image.fromarray(pictures[0])).save(tmp_path / name)
    with pytest.raises(CaptureError, match=message) as caught:
        read_photo(tmp_path / name, face_networks())
    assert name in str(caught.value)


def test_a_photo_is_turned_as_its_file_says_and_its_alpha_is_nothing(
    tmp_path: Path, pictures: list[ByteArray]
) -> None:
    face = Image.fromarray(pictures[0])
    exif = Image.Exif()
    exif[0x0112], exif[0x0110] = 6, "a phone"
    exif.get_ifd(0x8769)[0xA405] = 28
    face.rotate(90, expand=True).save(tmp_path / "turned.jpg", exif=exif, quality=95)
    face.convert("RGBA").save(tmp_path / "clear.png")
    (tmp_path / "phone.heic").write_bytes(heic_of(face.rotate(90, expand=True), quarter_turns=1))
    turned, clear, phone = (
        read_photo(tmp_path / name, face_networks())
        for name in ("turned.jpg", "clear.png", "phone.heic")
    )
    for photo in (turned, phone):
        assert np.abs(photo.landmarks - clear.landmarks)[:, :2].max() < 8
    assert turned.focal_px == pytest.approx(28 / 43.27 * np.hypot(SIDE, SIDE))
    assert clear.focal_px == 0


def test_a_folder_tells_what_it_leaves_out_and_goes_on(
    tmp_path: Path, pictures: list[ByteArray]
) -> None:
    Image.fromarray(pictures[0]).save(tmp_path / "face.png")
    Image.fromarray(pictures[3]).save(tmp_path / "profile.png")
    (tmp_path / "torn.jpg").write_bytes(b"\xff\xd8\xff")
    (tmp_path / "phone.heic").write_bytes(heic_of(Image.fromarray(pictures[0]))[:-5000])
    (tmp_path / "no.heic").write_bytes(b"\0\0\0\x18ftypheic")
    told: list[str] = []
    photos = read_photos(photo_paths(tmp_path), face_networks(), told.append)
    assert [photo.name for photo in photos] == ["face.png"]
    expected = ("not a complete photo", "not a complete photo", "profile.png", "not a complete")
    for line, words in zip(told, expected, strict=True):
        assert line.startswith("left out: ")
        assert words in line


def test_folders_without_photos_or_with_too_many_are_refused(tmp_path: Path) -> None:
    for folder, words in ((tmp_path / "none", "No such file"), (tmp_path, "0 photos; 1 to 60")):
        with pytest.raises(CaptureError, match=words):
            photo_paths(folder)


def test_the_command_takes_one_kind_of_input(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="one of --scan, --photos, --video"):
        me(MeOptions(photos=tmp_path, video=tmp_path, out=tmp_path / "capture"))
    with pytest.raises(CaptureError, match="--texture belongs to --scan"):
        me(MeOptions(photos=tmp_path, texture=tmp_path, out=tmp_path / "capture"))
    with pytest.raises(CaptureError, match="--pupillary-distance-mm belongs to --photos"):
        me(MeOptions(scan=tmp_path, pupillary_distance_mm=63, out=tmp_path / "capture"))
    with pytest.raises(CaptureError, match="distance_mm is 7; 40 to 80 is allowed"):
        me(MeOptions(photos=tmp_path, pupillary_distance_mm=7, out=tmp_path / "capture"))


def test_a_film_gives_one_frame_of_each_view(
    tmp_path: Path, pictures: list[ByteArray], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_film(tmp_path / "late.mp4", pictures[:3], 3.0)
    told: list[str] = []
    frames = choose_frames(tmp_path / "late.mp4", face_networks(), told.append)
    assert len(frames) == 3
    assert all(frame.landmarks[152, 1] > frame.landmarks[10, 1] + 100 for frame in frames)
    assert "30 frames looked at" in told[0]
    monkeypatch.setattr("pica_core.capture.me.film.LOOKED_AT", 5)
    assert len(choose_frames(tmp_path / "late.mp4", face_networks(), told.append)) == 3
    assert int(told[1].split()[0]) <= 10
    monkeypatch.setattr("pica_core.capture.me.film.DENSE_S", 0.3)
    frames = choose_frames(tmp_path / "late.mp4", face_networks(), told.append)
    assert frames[-1].name == "late.mp4 at 2.4 s"  # the third key frame
    write_film(tmp_path / "short.mp4", pictures[:1], 1.0)
    (tmp_path / "torn.mp4").write_bytes(b"no film")
    with wave.open(str(tmp_path / "sound.wav"), "wb") as sound:
        sound.setparams((1, 2, 8000, 0, "NONE", ""))
        sound.writeframes(bytes(8000))
    refused = {"short.mp4": "at least 2 s", "torn.mp4": "not a film", "sound.wav": "sound alone"}
    for name, words in refused.items():
        with pytest.raises(CaptureError, match=words):
            choose_frames(tmp_path / name, face_networks(), told.append)


def test_a_nersemble_folder_gives_the_first_picture_of_each_camera(
    tmp_path: Path, pictures: list[ByteArray]
) -> None:
    cameras = {str(number): np.eye(4).tolist() for number in range(5)}
    intrinsics = [[8200.0, 0, 1100], [0, 8200.0, 1604], [0, 0, 1]]
    (tmp_path / "calibration").mkdir()
    (tmp_path / "calibration" / "camera_params.json").write_text(
        json.dumps({"world_2_cam": cameras, "intrinsics": intrinsics})
    )
    with pytest.raises(CaptureError, match=r"0 photos; .* names on \.mp4"):
        camera_films(tmp_path)
    few = tmp_path / "sequences" / "SEN-10-b" / "images"
    few.mkdir(parents=True)
    (few / "cam_0.mp4").write_bytes(b"no film")
    images = tmp_path / "sequences" / "SEN-01-a" / "images"
    images.mkdir(parents=True)
    for number, picture in enumerate(pictures[:3]):
        write_film(images / f"cam_{number}.mp4", [picture, pictures[3]], 0.4)
    (images / "cam_3.mp4").write_bytes(b"no film")
    told: list[str] = []
    films = camera_films(tmp_path)
    photos = read_films(films, face_networks(), told.append)
    assert [photo.name for photo in photos] == ["cam_0.mp4", "cam_1.mp4", "cam_2.mp4"]
    assert photos[0].focal_px == pytest.approx(8200 / np.hypot(2200, 3208) * np.hypot(SIDE, SIDE))
    assert "4 films, of 5 cameras" in told[0]
    assert "cam_3.mp4: not a film" in told[1]
    (tmp_path / "calibration" / "camera_params.json").write_text('{"intrinsics": [[8200.0]]}')
    with pytest.raises(CaptureError, match=r"camera_params\.json: intrinsics and world_2_cam"):
        read_films(films, face_networks(), told.append)


@pytest.mark.slow
def test_photos_become_a_head_with_its_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "photos"
    write_photos(folder)
    monkeypatch.setattr("pica_core.cli.load_networks", face_networks)
    monkeypatch.setattr("pica_core.capture.me.scanned.TEXTURE_SIZE", 256)
    monkeypatch.setattr("pica_core.cli.render_me", lambda console, head, *_: {"head": str(head)})
    made = me(MeOptions(photos=folder, yes=True, out=tmp_path / "capture"))
    head = read_head(Path(made["head"]))
    assert head.source == "photos"
    assert head.licence.startswith("the person's own; face model: ICT")
    assert replace(head, source=NERSEMBLE_FILMS).licence.startswith("NeRSemble v2's")
    assert "back of the head" in head.guessed
    assert (head.texture[..., 3] > 127).mean() > 0.05  # outlines are wide on so small a chart
    page = (Path(made["head"]).parent / "report.html").read_text()
    assert page.count("data:image/jpeg") == 9
    told: list[str] = []
    photos = read_photos(photo_paths(folder), face_networks(), told.append)
    assert fit_photos(photos, told.append).off_px < 4
