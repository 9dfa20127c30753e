"""Each tracker's protocol against datagrams that were built from its specification."""

import math
import tracemalloc

import numpy as np
import pytest

from helpers import tracker_packets
from pica_client.sources.datagrams import (
    VmcDecoder,
    decode_ifacialmocap,
    decode_livelink,
    decoder_of,
)
from pica_client.sources.live_face import PacketError
from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit

MANY = {name: 0.01 * (index + 1) for index, name in enumerate(tracker_packets.LIVE_LINK_ORDER[:52])}


def test_live_link_gives_every_shape_its_own_value() -> None:
    sample = decode_livelink(tracker_packets.live_link(MANY, frame=90, sub_frame=0.5))

    for name, value in MANY.items():
        assert sample.arkit[ARKIT_INDEX[name[0].lower() + name[1:]]] == pytest.approx(value)
    assert sample.has_face
    assert sample.tracker_s == pytest.approx(90.5 / 60)


@pytest.mark.parametrize("rate", [(30, 0), (0, 1), (-60, 1)])
def test_a_face_of_live_link_whose_rate_is_none_has_no_time(rate: tuple[int, int]) -> None:
    sample = decode_livelink(tracker_packets.live_link(MANY, rate=rate))
    assert sample.has_face
    assert sample.tracker_s is None


@pytest.mark.parametrize(("angle", "axis"), [("HeadPitch", 0), ("HeadYaw", 1), ("HeadRoll", 2)])
def test_a_head_of_live_link_turns_about_one_axis(angle: str, axis: int) -> None:
    rotation = decode_livelink(tracker_packets.live_link({angle: -0.3})).rotation
    wanted = np.zeros(3)
    wanted[axis] = -0.3
    np.testing.assert_allclose(rotation, wanted, atol=1e-6)


@pytest.mark.parametrize("value", [math.nan, math.inf, 4.5])
def test_a_value_that_is_no_face_is_refused(value: float) -> None:
    with pytest.raises(PacketError, match="outside of"):
        decode_livelink(tracker_packets.live_link({"JawOpen": value}))


def test_vmc_takes_perfect_sync_in_any_case_and_holds_it_until_it_is_applied() -> None:
    decoder = VmcDecoder()
    assert decoder.decode(tracker_packets.osc("/VMC/Ext/Blend/Val", "JawOpen", 0.4)) == []
    assert decoder.decode(tracker_packets.osc("/VMC/Ext/Blend/Val", "EYEBLINKLEFT", 1)) == []
    (sample,) = decoder.decode(tracker_packets.osc("/VMC/Ext/Blend/Apply"))

    assert sample.arkit[ARKIT_INDEX["jawOpen"]] == pytest.approx(0.4)
    assert sample.arkit[ARKIT_INDEX["eyeBlinkLeft"]] == 1
    assert np.isnan(sample.arkit[ARKIT_INDEX["tongueOut"]])
    (again,) = decoder.decode(tracker_packets.vmc({"jawOpen": 0.1}, seconds=7))
    assert again.tracker_s == 7
    assert again.arkit[ARKIT_INDEX["eyeBlinkLeft"]] == 1


def test_expressions_of_a_plain_vrm_model_move_the_face_beside_shapes_by_their_own_names() -> None:
    values = {"A": 1.0, "Blink": 1.0, "Joy": 0.5, "Extra": 1.0}
    values |= {"TongueOut": 0.0, "EyeBlinkLeft": 0.25}
    (sample,) = VmcDecoder().decode(tracker_packets.vmc(values))
    seen = {name: float(sample.arkit[ARKIT_INDEX[name]]) for name in ARKIT_NAMES}
    assert seen["jawOpen"] == pytest.approx(0.7)
    assert seen["mouthSmileLeft"] == pytest.approx(0.4)
    assert (seen["eyeBlinkLeft"], seen["eyeBlinkRight"], seen["tongueOut"]) == (0.25, 1.0, 0.0)
    assert math.isnan(seen["browInnerUp"])


def test_vmc_keeps_no_names_that_no_face_has() -> None:
    decoder = VmcDecoder()
    tracemalloc.start()
    try:
        for k in range(100):
            decoder.decode(tracker_packets.vmc({f"Shape{k}-{n}": 1.0 for n in range(30)}))
        held_bytes, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held_bytes < 100_000


def test_vmc_without_apply_holds_from_one_round_to_the_next() -> None:
    decoder = VmcDecoder()
    seen = []
    for jaw in (0.1, 0.2, 0.3):
        for name in ("jawOpen", "browInnerUp"):
            packet = tracker_packets.osc("/VMC/Ext/Blend/Val", name, jaw)
            seen += [sample.arkit for sample in decoder.decode(packet)]
    jaw, brow = ARKIT_INDEX["jawOpen"], ARKIT_INDEX["browInnerUp"]
    assert np.array(seen)[:, [jaw, brow]] == pytest.approx(np.array([[0.1, 0.1], [0.2, 0.2]]))


def test_unitys_head_turned_to_the_subjects_left_turns_left_here() -> None:
    # In Unity, which is left-handed with y up, a turn of +30 degrees about y takes the nose, +z,
    # to +x. +x is the subject's right there, and -x here.
    half = math.radians(15)
    turned = (0.0, math.sin(half), 0.0, math.cos(half))
    bones = {"Neck": (0, 0, 0, 1), "Head": turned}
    (sample,) = VmcDecoder().decode(tracker_packets.vmc({"jawOpen": 0.0}, bones=bones))
    np.testing.assert_allclose(sample.rotation, [0, -math.radians(30), 0], atol=1e-6)


def test_eye_bones_are_the_gaze_of_a_model_without_look_shapes() -> None:
    # Unity's +10 degrees about y is to the subject's right; about x it is down.
    half = math.radians(5)
    right = (0.0, math.sin(half), 0.0, math.cos(half))
    down = (math.sin(half), 0.0, 0.0, math.cos(half))
    decoder = VmcDecoder()
    bones = {"LeftEye": right, "RightEye": right}
    (sample,) = decoder.decode(tracker_packets.vmc({"A": 0.2}, bones=bones))
    seen = {name: float(sample.arkit[ARKIT_INDEX[name]]) for name in ARKIT_NAMES}
    assert seen["eyeLookInLeft"] == seen["eyeLookOutRight"] == pytest.approx(10 / 35, rel=1e-4)
    assert seen["eyeLookOutLeft"] == seen["eyeLookInRight"] == 0
    bones = {"LeftEye": down}
    (sample,) = decoder.decode(tracker_packets.vmc({}, bones=bones))
    assert sample.arkit[ARKIT_INDEX["eyeLookDownLeft"]] == pytest.approx(10 / 28, rel=1e-4)
    (sample,) = decoder.decode(tracker_packets.vmc({"eyeLookUpLeft": 0.3}, bones=bones))
    assert sample.arkit[ARKIT_INDEX["eyeLookUpLeft"]] == pytest.approx(0.3)
    assert np.isnan(sample.arkit[ARKIT_INDEX["eyeLookDownLeft"]])


def test_ifacialmocap_says_where_the_head_is_and_nonsense_is_left_out() -> None:
    def place(*numbers: float) -> FloatArray | None:
        line = tracker_packets.ifacialmocap({"jawOpen": 1}, head=(0, 0, 0, *numbers))
        return decode_ifacialmocap(line).place_m

    assert place(-0.03, -0.1, -0.66) == pytest.approx([-0.03, -0.1, -0.66])
    assert place(0, 0, 0) is None
    assert place(3, 4, 66) is None  # centimetres of somebody else
    assert place() is None


def test_ifacialmocap_says_that_the_face_is_lost() -> None:
    states = (
        decode_ifacialmocap(tracker_packets.ifacialmocap({"jawOpen": 7, "trackingStatus": status}))
        for status in (1, 0)
    )
    assert [state.has_face for state in states] == [True, False]


@pytest.mark.parametrize("separator", ["-", "&"])
def test_ifacialmocap_gives_hundredths_and_degrees(separator: str) -> None:
    line = tracker_packets.ifacialmocap(
        {"mouthSmile_R": 25, "eyeBlink_L": 100, "jawOpen": 7, "FM_other": 50},
        head=(10, -20, 0, 0, 0, 0),
        separator=separator,
    )
    sample = decode_ifacialmocap(line)
    assert sample.arkit[ARKIT_INDEX["mouthSmileRight"]] == pytest.approx(0.25)
    assert sample.arkit[ARKIT_INDEX["eyeBlinkLeft"]] == 1
    assert sample.arkit[ARKIT_INDEX["jawOpen"]] == pytest.approx(0.07)
    assert np.linalg.norm(sample.rotation) == pytest.approx(math.radians(22.3), rel=0.01)
    assert sample.rotation[1] < 0 < sample.rotation[0]


def test_damaged_datagrams_fill_no_log(caplog: pytest.LogCaptureFixture) -> None:
    decode = decoder_of("vmc")
    for packet in (b"", b"no osc", b"#bundle\0" + bytes(9)):
        with pytest.raises(PacketError):
            decode(packet)
    assert caplog.text == ""
