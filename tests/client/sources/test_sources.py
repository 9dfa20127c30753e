"""Sources as functions of time: Live Link Face files, looping, interpolation, naming; the
performances that ship against the statistics of seven real Live Link Face takes."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.paths import SHARED_DATA
from pica_client.errors import SourceError
from pica_client.sources import Recording, open_source
from pica_client.sources.live_face import (
    rotation_vector_from_yaw_pitch_roll,
    yaw_pitch_roll_from_rotation_vector,
)
from pica_client.sources.registry import load_livelink_csv
from pica_client.sources.source import PERFORMANCES, make_performance
from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES

pytestmark = pytest.mark.unit

FPS = 30
UNKNOWN = "is unknown; write csv:FILE"

REAL_TAKE = SHARED_DATA / "livelink/range_of_motion.csv"

APP_ORDER = [name[0].upper() + name[1:] for name in ARKIT_NAMES]
for _first, _second in (("JawLeft", "JawRight"), ("MouthLeft", "MouthRight")):
    _a, _b = APP_ORDER.index(_first), APP_ORDER.index(_second)
    APP_ORDER[_a], APP_ORDER[_b] = APP_ORDER[_b], APP_ORDER[_a]
EYES = [f"{side}Eye{angle}" for side in ("Left", "Right") for angle in ("Yaw", "Pitch", "Roll")]
HEADER = ["Timecode", "BlendShapeCount", *APP_ORDER, "HeadYaw", "HeadPitch", "HeadRoll", *EYES]


def take_row(timecode: str, **values: float) -> list[str]:
    return [timecode, "61", *(f"{values.get(name, 0.0):.10f}" for name in HEADER[2:])]


def write_take(path: Path, rows: list[list[str]]) -> Path:
    path.write_text("".join(",".join(row) + "\n" for row in [HEADER, *rows]))
    return path


@pytest.fixture
def take(tmp_path: Path) -> Path:
    """Three frames at 30 a second: a jaw that opens to the right."""
    return write_take(
        tmp_path / "take.csv",
        [
            take_row("10:00:59:58.000", JawOpen=0.0, JawRight=0.2),
            take_row("10:01:00:00.000", JawOpen=0.5, JawRight=0.4),
            take_row("10:01:00:02.000", JawOpen=1.0, JawRight=0.6),
        ],
    )


def test_a_take_is_read_by_names_at_its_own_clock_and_interpolated(take: Path) -> None:
    recording = load_livelink_csv(take)  # sixty frames a second, across a minute
    assert recording.times_s == pytest.approx([0, 1 / 30, 2 / 30])
    face = recording.frame_at(1 / 60)
    shown = [face.arkit[ARKIT_INDEX[name]] for name in ("jawOpen", "jawRight", "jawLeft")]
    assert shown == pytest.approx([0.25, 0.3, 0.0])
    assert face.captured_us == 16_667
    odd = take.rename(take.with_name("me@home.csv"))
    assert open_source(f"csv:{odd}").frame_at(0.0).has_face
    later = open_source(f"csv:{odd}@{1 / 30}").frame_at(0.0)
    assert later.arkit[ARKIT_INDEX["jawOpen"]] == pytest.approx(0.5)


def test_a_take_that_a_spreadsheet_saved_is_the_same(take: Path) -> None:
    own = load_livelink_csv(take)
    text = take.read_text().replace(",", ";").replace(".", ",").replace("\n", "\r\n")
    take.write_bytes(b"\xef\xbb\xbf" + text.encode())
    saved = load_livelink_csv(take)
    np.testing.assert_array_equal(saved.arkit, own.arkit)
    np.testing.assert_array_equal(saved.times_s, own.times_s)


def test_a_take_across_midnight_goes_on(tmp_path: Path) -> None:
    rows = [take_row("23:59:59:59.000"), take_row("00:00:00:01.000")]
    recording = load_livelink_csv(write_take(tmp_path / "night.csv", rows))
    assert recording.times_s == pytest.approx([0, 2 / 60])


def test_a_row_without_blendshapes_is_a_moment_without_a_face(tmp_path: Path) -> None:
    rows = [
        take_row("10:00:00:00.000", JawOpen=0.5),
        ["10:00:00:02.000", "0"],
        take_row("10:00:00:04.000", JawOpen=0.7),
    ]
    recording = load_livelink_csv(write_take(tmp_path / "away.csv", rows))
    assert [recording.frame_at(t / 30).has_face for t in (0.0, 1.5, 2.2)] == [True, False, True]
    # Up to the gap the last seen face stays; nothing is mixed with the empty row.
    assert recording.frame_at(0.9 / 30).arkit[ARKIT_INDEX["jawOpen"]] == pytest.approx(0.5)


def test_yaw_pitch_and_roll_compose_from_the_outside_in_and_come_back() -> None:
    angles = np.random.default_rng(0).uniform(-1.4, 1.4, (50, 3))
    vectors = rotation_vector_from_yaw_pitch_roll(angles)
    np.testing.assert_allclose(
        Rotation.from_rotvec(vectors).as_matrix(),
        Rotation.from_euler("YXZ", angles).as_matrix(),
        atol=1e-6,
    )
    back = [yaw_pitch_roll_from_rotation_vector(vector) for vector in vectors]
    np.testing.assert_allclose(back, angles, atol=1e-5)


@pytest.mark.skipif(not REAL_TAKE.exists(), reason="the real recording is not here")
def test_a_real_recording_is_read_whole() -> None:
    recording = load_livelink_csv(REAL_TAKE)
    assert len(recording.times_s) == 4030
    # 134.4 s at 30 frames a second; the tracker dropped a few frames, its clock did not.
    assert recording.duration_s == pytest.approx(134.4, abs=1.0)
    assert recording.loop_gap_s == pytest.approx(1 / 30, rel=1e-3)
    assert 0.9 < recording.arkit[:, ARKIT_INDEX["jawOpen"]].max() <= 1.05
    assert recording.has_face.all()
    assert not recording.rotation.any()  # head tracking was off


BAD_TAKES = (
    ("0.4000000000", "open", "line 3: could not convert string to float: 'open'"),
    ("0.4000000000", "1e9", "line 3: a value lies outside"),
    ("10:01:00:00.000", "25:00:00:00", "line 3: timecode '25:00:00:00'"),
    ("10:01:00:02.000", "10:01:00:00.000", "line 4: its timecode does not come after"),
    ("JawOpen", "Jaw", r"lacks 1 of 54 columns \(jawOpen"),
    (",0.4000000000", "", "line 3: has 62 of 63 values"),
    (",61,", ",0,", "no frame holds a face"),
)


@pytest.mark.parametrize(("old", "new", "message"), BAD_TAKES)
def test_a_bad_take_is_refused_in_one_line(take: Path, old: str, new: str, message: str) -> None:
    take.write_text(take.read_text().replace(old, new))
    with pytest.raises(SourceError, match=message):
        load_livelink_csv(take)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (None, r"cannot be read \(No such file"),
        (b"", "lacks 54 of 54 columns"),
        (",".join(HEADER).encode(), "has 0 frames"),
        (bytes(range(256)), "is not a CSV text file"),
    ],
)
def test_a_file_that_is_no_take_is_refused(
    tmp_path: Path, data: bytes | None, message: str
) -> None:
    path = tmp_path / "bad.csv"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(SourceError, match=rf"bad\.csv: .*{message}"):
        load_livelink_csv(path)


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_a_frame_without_numbers_shows_nobody_and_is_told_of(
    take: Path, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    take.write_text(take.read_text().replace("0.4000000000", value))
    recording = load_livelink_csv(take)
    assert list(recording.has_face) == [True, False, True]
    assert np.isfinite(recording.arkit).all()
    told = f"{take}: 1 of 3 frames are lost, they hold NaN or infinity\n"
    assert capsys.readouterr().err == told
    lost = take.read_text().replace("0.2000000000", value).replace("0.6000000000", value)
    take.write_text(lost)
    with pytest.raises(SourceError, match="no frame holds a face and numbers alone"):
        load_livelink_csv(take)


# The text that names a source.


def test_a_performance_is_named_with_seed_and_start() -> None:
    source = open_source("performance:talk#3@12.5")
    plain = open_source("performance:talk#3")
    assert isinstance(source, Recording)
    np.testing.assert_array_equal(source.frame_at(0).arkit, plain.frame_at(12.5).arkit)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", UNKNOWN),
        ("talk", UNKNOWN),
        ("csv:", UNKNOWN),
        ("camera:0", UNKNOWN),
        ("performance:", UNKNOWN),
        ("performance:talk#x", "seed 'x' is not a number"),
        ("csv:x@-5", "the start is -5 s; 0 or more is allowed"),
        ("csv:x@nan", "the start is nan s; 0 or more is allowed"),
        ("csv:x@inf", "the start is inf s; 0 or more is allowed"),
        ("livelink:x", "'x' is no port; write livelink:11111"),
        ("livelink:70000", "'70000' is no port"),
        ("vmc:nohost:1", "'nohost:1' is no port"),
        ("ifacialmocap", "needs the phone's address"),
        ("facemotion3d:phone", "needs the phone's address"),
    ],
)
def test_a_source_that_cannot_be_is_one_line_with_the_forms(text: str, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        open_source(text)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", PERFORMANCES)
def test_a_performance_has_the_statistics_of_real_recordings(name: str, seed: int) -> None:
    recording = make_performance(name, seed=seed)
    values = np.stack([recording.frame_at(index / FPS).arkit for index in range(60 * FPS)])
    energy = np.linalg.svd(values - values.mean(axis=0), compute_uv=False) ** 2
    components = int(np.searchsorted(np.cumsum(energy) / energy.sum(), 0.95)) + 1
    low, high = {"talk": (5, 6), "listen": (4, 6), "range_of_motion": (12, 15)}[name]
    assert low <= components <= high
    steps = np.abs(np.diff(values, axis=0))
    assert 0.001 <= steps.mean() <= 0.006
    assert steps.max() >= 0.4  # a blink jumps
    assert values.min() >= 0
    assert values.max() <= 1
    assert (values[:, ARKIT_INDEX["mouthClose"]] - values[:, ARKIT_INDEX["jawOpen"]]).max() <= 0.07
    assert np.degrees(np.abs(recording.rotation).max()) <= 20


@pytest.mark.parametrize("name", PERFORMANCES)
def test_the_loop_closes_without_a_jump(name: str) -> None:
    recording = make_performance(name)
    for track in (recording.arkit, recording.rotation, recording.translation_m):
        assert np.abs(track[-1] - track[0]).max() <= 0.02


def test_every_seed_is_another_player_or_begins_elsewhere() -> None:
    faces = [make_performance("talk", seed=seed).frame_at(7.0).arkit for seed in range(12)]
    assert len({face.tobytes() for face in faces}) == 12
