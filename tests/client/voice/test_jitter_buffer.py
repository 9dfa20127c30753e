import itertools
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.spoken import CLOCK_OFFSET_US, NETWORK_S, SpokenDecoder, hum, packet, usual_arrival_s
from pica_client.voice.jitter_buffer import (
    CEILING_S,
    CODEC_DELAY_S,
    LEAST_JITTER_S,
    MAX_PACKETS,
    HeardVoice,
    JitterBuffer,
)
from pica_client.voice.opus import FRAME_S
from pica_client.voice.opus import FRAME_SAMPLES as FRAME
from pica_client.voice.opus import SAMPLE_RATE_HZ as RATE_HZ
from pica_core.types import FloatArray
from pica_protocol.frames import Frame

pytestmark = pytest.mark.unit

WAIT_S = FRAME_S + LEAST_JITTER_S
Arrivals = Iterable[tuple[float, Frame]]


def play(
    buffer: JitterBuffer, arrivals: Arrivals, seconds: float, *, tick_s: float = FRAME_S
) -> tuple[FloatArray, list[float]]:
    """The sound of some time, and the delay of each tick that has one."""
    waiting = sorted(arrivals, key=lambda arrival: arrival[0])
    sounds, delays_s = [], []
    for now in np.arange(0.007, seconds, tick_s):
        while waiting and waiting[0][0] <= now:
            buffer.receive(waiting[0][1], waiting[0][0])
            del waiting[0]
        sounds.append(buffer.pull(float(now)))
        if buffer.moment is not None:
            delays_s.append(now - (buffer.moment[1] - CLOCK_OFFSET_US) / 1e6)
    return np.concatenate(sounds), delays_s


def with_pauses(sound: FloatArray) -> FloatArray:
    """Half a second of speech, half a second of none."""
    seconds = np.arange(len(sound)) / RATE_HZ
    return np.where(seconds % 1 < 0.5, sound, np.float32(0))


def on_time(num_frames: int, *, skip: Iterable[int] = ()) -> list[tuple[float, Frame]]:
    left_out = set(skip)
    return [(usual_arrival_s(i), packet(i)) for i in range(num_frames) if i not in left_out]


def test_a_calm_voice_is_played_as_it_is_a_frame_and_a_half_after_the_fastest():
    sound = hum(3)
    buffer = JitterBuffer(SpokenDecoder(sound))

    played, delays_s = play(buffer, on_time(140), 2.5)

    expected_s = FRAME_S + NETWORK_S + WAIT_S + CODEC_DELAY_S
    assert max(delays_s) == pytest.approx(expected_s, abs=0.003)
    report = buffer.report
    assert (report.concealed, report.lost) == (0, 0)
    place = int(np.argmax(np.abs(played) > 0.01))
    middle = played[RATE_HZ : 2 * RATE_HZ]
    best = np.correlate(sound[: 2 * RATE_HZ], middle, "valid").max()
    assert place > 0
    assert best > 0.98 * np.dot(middle, middle)


@pytest.mark.parametrize("late_s", [0.03, 0.15])
def test_the_delay_grows_in_silence_with_the_lateness_of_packets_up_to_the_ceiling(late_s: float):
    rng = np.random.default_rng(1)
    sound = with_pauses(hum(12))
    buffer = JitterBuffer(SpokenDecoder(sound))
    times = itertools.accumulate(
        (usual_arrival_s(i) + late_s * rng.random() for i in range(590)), max
    )

    played, delays_s = play(buffer, [(time, packet(i)) for i, time in enumerate(times)], 11.5)

    report = buffer.report
    loud = np.abs(played) > 0.01
    assert loud.mean() == pytest.approx((np.abs(sound) > 0.01).mean(), abs=0.04)
    wait_s = np.median(delays_s[-200:]) - (FRAME_S + NETWORK_S + CODEC_DELAY_S)
    assert FRAME_S + 0.5 * late_s - 0.03 < wait_s < CEILING_S + 0.03
    assert report.concealed_ratio < 0.05


def test_a_delay_that_is_no_longer_needed_is_given_up_slowly():
    buffer = JitterBuffer(SpokenDecoder(with_pauses(hum(32))))
    late = {i: 0.06 for i in range(100, 300, 9)}
    times = itertools.accumulate((usual_arrival_s(i) + late.get(i, 0) for i in range(1490)), max)
    arrivals = [(time, packet(i)) for i, time in enumerate(times)]

    _, delays_s = play(buffer, arrivals, 29.5)

    calm_s, late_s, later_s = delays_s[80], delays_s[600], delays_s[-1]
    assert delays_s[320] > calm_s + 0.04
    assert calm_s + 0.015 < late_s  # 6 s after the last one that was late
    assert later_s == pytest.approx(calm_s, abs=0.01)


def test_a_way_that_is_longer_for_good_is_waited_for_no_longer_than_it_is():
    buffer = JitterBuffer(SpokenDecoder(with_pauses(hum(20))))
    arrivals = [(usual_arrival_s(i) + 0.04 * (i >= 200), packet(i)) for i in range(890)]

    _, delays_s = play(buffer, arrivals, 17.5)

    # The fastest packets of the shorter way are forgotten six seconds later: nobody hears it.
    at_first_s, later_s = delays_s[400], delays_s[550:700]
    assert at_first_s > delays_s[150] + 0.02
    assert max(later_s) == pytest.approx(at_first_s, abs=0.004)


def test_lost_packets_are_concealed_by_the_codec_and_time_goes_on():
    decoder = SpokenDecoder(hum(4))
    buffer = JitterBuffer(decoder)

    _, delays_s = play(buffer, on_time(190, skip=(50, 80, 81)), 3.5)

    assert 3 <= decoder.concealed <= 4  # the two in a row may take part of a third frame
    assert buffer.report.lost == 3
    assert max(delays_s[100:]) - min(delays_s[:40]) < 0.012


def test_packets_of_40_ms_are_played_as_soon_and_lost_ones_concealed_whole():
    def pair(index: int) -> tuple[float, Frame]:
        whole = packet(2 * index, sequence=index)
        return usual_arrival_s(2 * index + 1), replace(whole, payload=whole.payload + b"+")

    decoder = SpokenDecoder(hum(4))
    buffer = JitterBuffer(decoder)

    _, delays_s = play(buffer, [pair(i) for i in range(95) if i not in (25, 40)], 3.5)

    assert 4 <= decoder.concealed <= 5  # the stretching may take part of another
    assert buffer.report.lost == 2
    expected_s = 2 * FRAME_S + NETWORK_S + WAIT_S + CODEC_DELAY_S
    assert np.median(delays_s) == pytest.approx(expected_s, abs=0.005)


def test_a_silence_that_is_not_sent_is_neither_a_loss_nor_concealed():
    rng = np.random.default_rng(0)
    sound = hum(6)
    room = (0.002 * rng.standard_normal(len(sound))).astype(np.float32)
    sound[RATE_HZ : 4 * RATE_HZ] = 0
    sound += room
    decoder = SpokenDecoder(sound)
    buffer = JitterBuffer(decoder)
    # Sent: speech, ten quiet frames, one refresh each 400 ms, speech.
    sent = [i for i in range(290) if i < 60 or i >= 200 or i % 20 == 0]
    arrivals = [(usual_arrival_s(i), packet(i, sequence=n)) for n, i in enumerate(sent)]

    played, _ = play(buffer, arrivals, 5.5)

    assert decoder.concealed == 0
    assert buffer.report.lost == 0
    assert np.std(played[2 * RATE_HZ : 4 * RATE_HZ]) < 0.002


def test_a_short_stall_loses_no_word_and_after_a_long_one_the_voice_is_fresh_within_two_seconds():
    for begin, end_s, is_long in ((200, 4.2, False), (200, 5.0, True)):
        buffer = JitterBuffer(SpokenDecoder(with_pauses(hum(12))))
        arrivals = [
            (usual_arrival_s(i) if i < begin else max(usual_arrival_s(i), end_s), packet(i))
            for i in range(590)
        ]

        _, delays_s = play(buffer, arrivals, 11.5)

        report = buffer.report
        assert (report.lost > 0) == is_long
        assert report.concealed_ratio < 0.1
        before_s, after_s = np.median(delays_s[:150]), max(delays_s[round(7.0 / FRAME_S) :])
        assert after_s < before_s + 0.2


@pytest.mark.parametrize("ppm", [-300, 300])
def test_a_loudspeaker_with_a_clock_of_its_own_neither_starves_nor_falls_behind(ppm: int):
    buffer = JitterBuffer(SpokenDecoder(with_pauses(hum(32))))

    _, delays_s = play(buffer, on_time(1500), 29.0, tick_s=FRAME_S * (1 + ppm * 1e-6))

    assert buffer.report.concealed_ratio < 0.002
    assert abs(np.mean(delays_s[-100:]) - np.mean(delays_s[100:200])) < 0.012


def test_what_was_muted_begins_anew_without_the_past():
    buffer = JitterBuffer(SpokenDecoder(hum(20)))
    arrivals = [(usual_arrival_s(i), packet(i)) for i in range(100)]
    arrivals += [(usual_arrival_s(i), packet(i, sequence=i - 500)) for i in range(600, 700)]

    _, delays_s = play(buffer, arrivals, 14.0)

    assert max(delays_s[-90:]) < NETWORK_S + 3 * FRAME_S + CODEC_DELAY_S
    assert buffer.report.lost == 0


def test_nothing_is_heard_before_the_first_packet_and_long_after_the_last():
    buffer = JitterBuffer(SpokenDecoder(hum(2)))
    assert not buffer.pull(0.0).any()
    assert buffer.moment is None
    play(buffer, on_time(40), 1.0)
    assert buffer.moment is not None
    buffer.pull(4.0)
    assert buffer.moment is None


def test_the_moment_that_is_heard_counts_the_latency_of_the_loudspeaker():
    voice = HeardVoice()
    assert voice.at(10.0) is None
    for tick in range(5):
        voice.receive((10.1 + tick * FRAME_S, tick * 20_000, (tick + 1) * 20_000))
    assert voice.at(10.0) is None
    assert voice.at(10.15) == pytest.approx(50_000)
    assert voice.at(10.4) == 120_000  # it stands still
    assert voice.at(11.0) is None


def test_a_packet_that_the_codec_refuses_is_concealed_and_counted():
    decoder = SpokenDecoder(hum(2))
    buffer = JitterBuffer(decoder)
    arrivals = on_time(90)
    at, bad = arrivals[40]
    arrivals[40] = at, replace(bad, payload=b"")

    play(buffer, arrivals, 1.5)

    assert buffer.report.lost == 1
    assert decoder.concealed == 1


@given(
    st.lists(
        st.tuples(st.integers(0, 65535), st.integers(0, 2**64 - 1), st.floats(0, 0.1)), max_size=90
    )
)
def test_any_packets_are_played_as_whole_frames_of_finite_sound(
    packets: list[tuple[int, int, float]],
):
    buffer, now = JitterBuffer(SpokenDecoder(hum(1))), 0.0
    for sequence, captured_us, wait_s in packets:
        now += wait_s
        payload = (sequence % 40).to_bytes(4, "big")
        frame = Frame(stream=1, sequence=sequence, captured_us=captured_us, payload=payload)
        buffer.receive(frame, now)
        sound = buffer.pull(now)
        assert sound.shape == (FRAME,)
        assert np.isfinite(sound).all()
        assert len(buffer.waiting) <= MAX_PACKETS
