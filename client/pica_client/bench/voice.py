"""What arrives of a voice and its face on troubled networks: quality, delay, and their step. On a
virtual clock, with the real codec, jitter buffer and playout, so every figure comes out the same on
every machine with the same libopus (processor time apart).

Voice and face share one way; figures are of the troubled third of the run. PESQ is of the sound as
it leaves the loudspeaker; for STOI each piece of sound is laid back to the moment when it was
captured. `skew_ms` is the moment of the face less that of the voice. What it does not show:
devices, real networks (see `network.impairment`), people: the speech is synthetic, and PESQ and
STOI stand for listeners.
"""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from pica_client.bench.harness import Words, check_names, report
from pica_client.bench.network.scenarios import BY_NAME, SCENARIOS
from pica_client.bench.network.stream_trial import (
    CLOCK_OFFSET_US,
    DISPLAY_PHASE,
    VOICE_STREAM,
    Delivery,
    Schedule,
    deliver,
    receive_arrival,
)
from pica_client.bench.playout import open_ends, true_face
from pica_client.errors import check_ranges
from pica_client.output import say
from pica_client.playout.buffer import Playout
from pica_client.stats import percentile
from pica_client.voice.jitter_buffer import JitterBuffer
from pica_client.voice.opus import OpusDecoder, OpusEncoder
from pica_client.voice.packet import FRAME_S, PACKET_FRAMES
from pica_client.voice.packet import FRAME_SAMPLES as FRAME
from pica_client.voice.packet import SAMPLE_RATE_HZ as RATE_HZ
from pica_client.voice.sound.settings import HeardVoice
from pica_client.voice.source import resampled, shipped_speech
from pica_core.avatar.file import Avatar
from pica_core.types import Array, FloatArray
from pica_protocol.frames import SEQUENCE_MODULUS, Frame

ROOM_RMS = 0.001
"""Noise of the speaker's room: -60 dB of full scale."""
SPOKEN_RMS = 0.005
"""Above it there is speech."""
SCORE_HZ = 16_000
"""What PESQ and STOI take."""
FILL_S = 0.015
"""Holes up to this long are periods of the pitch that were left out."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchVoiceConfig:
    """What to compare."""

    source: str = "performance:talk"
    """The face that goes along; see pica send --help."""
    kbps: int = 24
    """Bit rate of the voice, kbit/s."""
    scenarios: Words = ()
    """Names of troubles, separated by commas; all by default."""
    schedule: Annotated[Schedule, Parameter(name="*")] = field(default_factory=Schedule)
    """When frames are captured and shown."""
    seed: int = 0
    """Seed of the network and of the room's noise."""

    def __post_init__(self) -> None:
        check_names("scenario", self.scenarios, BY_NAME)
        check_ranges(self.schedule, seconds=(9, 600))
        check_ranges(self, kbps=(6, 128), seed=(0, 2**32))


@dataclass(frozen=True, slots=True, eq=False)
class _Heard:
    """What came out of one run; moments are seconds of the sender's clock."""

    sound: FloatArray
    moments: Array
    """When each sample was captured; NaN where nothing was heard. ``[ticks, FRAME]``."""
    skews: list[tuple[float, float, bool]]
    """(time, skew, whether the face stands still for want of frames), seconds."""
    counted: Array
    """(time, played, concealed, stretched) after each tick. ``[ticks, 4]``."""
    cpu_s: float

    @property
    def delays_s(self) -> Array:
        """How old the sound of each tick is when it leaves the loudspeaker."""
        delays_s: Array = self.counted[:, 0] - self.moments[:, 0]
        return delays_s


def run_bench_voice(config: BenchVoiceConfig, avatar: Avatar) -> dict[str, Any]:
    """Run all scenarios."""
    schedule = config.schedule
    sound = _speech(schedule.seconds, config.seed)
    frames = sound[: len(sound) // FRAME * FRAME].reshape(-1, FRAME)
    loud = np.sqrt(np.mean(np.square(frames), axis=1)) > SPOKEN_RMS

    def is_spoken(captured_us: int) -> bool:
        place = int((captured_us - CLOCK_OFFSET_US) / 1e6 / FRAME_S)
        return 0 <= place < len(loud) and bool(loud[place])

    face = true_face(config.source, avatar)
    chosen = [BY_NAME[name] for name in config.scenarios] or list(SCENARIOS)
    rows = []
    begin_s = time.process_time()
    voice = _packets(sound, config.kbps * 1000)
    encode_s = time.process_time() - begin_s
    for scenario in chosen:
        ends = open_ends(avatar, schedule.fps)
        delivery = deliver(face, ends, scenario, schedule, seed=config.seed, voice=voice)
        heard = _listen(delivery, schedule, is_spoken)
        rows.append(
            {
                "condition": scenario.name,
                "wire_bps": round(delivery.wire_bytes * 8 / schedule.seconds),
                **_quality(sound, heard, schedule),
                **_timing(heard, schedule),
                "cpu_ms_per_s": round((encode_s + heard.cpu_s) / schedule.seconds * 1e3, 2),
            }
        )
        say(f"{scenario.name}: {scenario.note}")
    return report(config, rows, avatar=avatar.manifest.name)


def _speech(seconds: float, seed: int) -> FloatArray:
    """The shipped sentences again and again, in a room that is not quite silent."""
    size = int(seconds / FRAME_S) * FRAME
    room = np.random.default_rng(seed).standard_normal(size).astype(np.float32)
    sound: FloatArray = np.resize(shipped_speech(), size) + ROOM_RMS * room
    return sound


def _packets(sound: FloatArray, bitrate: int) -> list[tuple[float, Frame]]:
    """The packets of a sound, of 40 ms, each sent when its last sample has been captured."""
    encoder = OpusEncoder(bitrate=bitrate)
    packets: list[tuple[float, Frame]] = []
    for index in range(0, len(sound) // FRAME - 1, PACKET_FRAMES):
        payload = encoder.encode(sound[index * FRAME :][: PACKET_FRAMES * FRAME])
        if payload is not None:
            frame = Frame(
                stream=VOICE_STREAM,
                sequence=len(packets) % SEQUENCE_MODULUS,
                captured_us=CLOCK_OFFSET_US + round(index * FRAME_S * 1e6),
                payload=payload,
            )
            packets.append(((index + PACKET_FRAMES) * FRAME_S, frame))
    return packets


def _listen(delivery: Delivery, schedule: Schedule, is_spoken: Callable[[int], bool]) -> _Heard:
    """Play what came: ticks of sound and refreshes of the display, in the order of time."""
    buffer, voice, playout = JitterBuffer(OpusDecoder()), HeardVoice(), Playout()
    arrivals: list[tuple[float, Any]] = [
        *((frame.arrived_s, frame) for frame in delivery.arrivals),
        *delivery.voices,
    ]
    arrivals.sort(key=lambda arrival: arrival[0])
    num_ticks = int(schedule.seconds / FRAME_S)
    refreshes = int(schedule.seconds * schedule.display_hz)
    events = [((k + DISPLAY_PHASE) * FRAME_S, True) for k in range(num_ticks)]
    events += [((k + DISPLAY_PHASE) / schedule.display_hz, False) for k in range(refreshes)]
    sounds: list[FloatArray] = []
    moments = np.full((num_ticks, FRAME), np.nan)
    skews: list[tuple[float, float, bool]] = []
    counted: list[tuple[float, int, int, int]] = []
    cpu_s, position, samples = 0.0, 0, delivery.samples()
    for now, is_sound in sorted(events):
        begin_s = time.process_time()
        while position < len(arrivals) and arrivals[position][0] <= now:
            arrived_s, arrival = arrivals[position]
            position += 1
            if isinstance(arrival, Frame):
                buffer.receive(arrival, arrived_s)
            else:
                receive_arrival(playout, arrival, samples)
        if not is_sound:
            heard_us = voice.at(now)
            face = playout.sample_at(now, heard_us)
            is_heard = bool(sounds) and float(np.std(sounds[-1])) > SPOKEN_RMS
            if face is None:
                continue
            if heard_us is not None and is_heard and is_spoken(heard_us):
                skews.append((now, (face.captured_us - heard_us) / 1e6, face.is_concealed))
            continue
        sounds.append(buffer.pull(now))
        cpu_s += time.process_time() - begin_s
        report = buffer.report()
        if buffer.moment is not None:
            voice.receive(buffer.moment)
            moments[len(sounds) - 1] = (buffer.moments_us - CLOCK_OFFSET_US) / 1e6
        counted.append((now, report.played, report.concealed, report.stretched))
    return _Heard(np.concatenate(sounds), moments, skews, np.array(counted), cpu_s)


def _quality(sound: FloatArray, heard: _Heard, schedule: Schedule) -> dict[str, Any]:
    """PESQ and STOI of the troubled third."""
    from pesq import PesqError, pesq
    from pystoi import stoi

    size = len(sound)
    moments = heard.moments.ravel()
    fits = (moments >= 0) & (moments < (size - 1) / RATE_HZ)  # false for NaN
    places = np.round(moments[fits] * RATE_HZ).astype(np.int64)
    back, is_there = np.zeros(size, np.float32), np.zeros(size, bool)
    back[places], is_there[places] = heard.sound[fits], True
    _fill_holes(back, is_there)
    cut = slice(int(schedule.begin_s * RATE_HZ), int(schedule.end_s * RATE_HZ))
    true, laid = (resampled(each[cut], RATE_HZ, SCORE_HZ) for each in (sound, back))
    # Sample k of the sound leaves the loudspeaker at the first tick's time plus k samples.
    shift = round((np.nanmedian(heard.delays_s) - heard.counted[0, 0]) * RATE_HZ)
    played = heard.sound[cut.start + shift : cut.stop + shift]
    played = np.pad(played, (0, cut.stop - cut.start - len(played)))
    try:
        score = round(float(pesq(SCORE_HZ, true, resampled(played, RATE_HZ, SCORE_HZ), "wb")), 2)
    except PesqError:  # nothing that sounds like an utterance is left
        score = None
    return {"pesq": score, "stoi": round(float(stoi(true, laid, SCORE_HZ)), 3)}


def _fill_holes(sound: FloatArray, is_there: Array) -> None:
    """Go on with the sample before where a period was left out."""
    edges = np.flatnonzero(np.diff(np.concatenate([[1], is_there.astype(np.int8), [1]])))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if begin > 0 and end - begin <= FILL_S * RATE_HZ:
            piece = sound[max(begin - (end - begin), 0) : begin]
            sound[end - len(piece) : end] = piece


def _timing(heard: _Heard, schedule: Schedule) -> dict[str, Any]:
    begin_s, end_s = schedule.begin_s, schedule.end_s
    is_troubled = (heard.counted[:, 0] >= begin_s) & (heard.counted[:, 0] < end_s)
    delays_s = heard.delays_s[is_troubled]
    refreshes = [row for row in heard.skews if begin_s <= row[0] < end_s]
    skews = [skew for _, skew, _ in refreshes]
    num_held = sum(is_held for *_, is_held in refreshes)
    counts = heard.counted[is_troubled]
    ticks, (played, concealed, stretched) = len(counts), (counts[-1] - counts[0])[1:]
    return {
        "mouth_to_ear_ms": _ms(delays_s[~np.isnan(delays_s)], 50, 95),
        "skew_ms": {
            **_ms(map(abs, skews), 50, 95),
            "worst": round(max(skews, key=abs, default=0.0) * 1e3, 1),
            "earliest": round(min(skews, default=0.0) * 1e3, 1),
        },
        "face_held_ratio": round(num_held / max(len(refreshes), 1), 4),
        "concealed_ratio": round(float(concealed / max(played + concealed, 1)), 4),
        "stretched_ratio": round(float(stretched / ticks), 4),
    }


def _ms(samples_s: Iterable[float], *percents: int) -> dict[str, float | None]:
    values = sorted(map(float, samples_s))
    return {
        f"p{percent}": round(percentile(values, percent) * 1e3, 1) if values else None
        for percent in percents
    }
