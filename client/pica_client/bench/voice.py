"""What arrives of a voice and its face on troubled networks: quality, delay, and their step. On a
virtual clock, with the real codec, jitter buffer and playout, so every figure comes out the same on
every machine with the same libopus.

Voice and face share one way; figures are of the troubled third of the run. PESQ is of the sound as
it leaves the loudspeaker. `skew_ms` is the moment of the face less that of the voice. `face_mse` is
against the true face at the moment that should be shown, with the head where it truly was. What it
does not show: devices, real networks (see `impairment`), people: speech, performances and
avatars are synthetic, and PESQ stands for listeners.
"""

import math
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from pica_client.bench.harness import FaceRenderer, Words, check_names, report
from pica_client.bench.impairment import BY_NAME, CALM, SCENARIOS
from pica_client.bench.stream_trial import (
    CLOCK_OFFSET_US,
    DISPLAY_HZ,
    DISPLAY_PHASE,
    FPS,
    VOICE_STREAM,
    Delivery,
    Face,
    Tick,
    deliver,
    play,
)
from pica_client.errors import check_ranges
from pica_client.playout.buffer import Playout
from pica_client.render.drawing import drawn_mse
from pica_client.sources.source import make_performance
from pica_client.stats import summarise_ms
from pica_client.system import say
from pica_client.voice.jitter_buffer import HeardVoice, JitterBuffer
from pica_client.voice.opus import FRAME_S, PACKET_FRAMES, OpusDecoder, OpusEncoder
from pica_client.voice.opus import FRAME_SAMPLES as FRAME
from pica_client.voice.opus import SAMPLE_RATE_HZ as RATE_HZ
from pica_client.voice.source import BITRATE_BPS, resampled, shipped_speech
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder
from pica_core.types import FloatArray
from pica_protocol.frames import SEQUENCE_MODULUS, Frame

ROOM_RMS = 0.001
"""Noise of the speaker's room: -60 dB of full scale."""
SPOKEN_RMS = 0.005
"""Above it there is speech."""
SCORE_HZ, SCORE_S = 16_000, 10
"""What PESQ takes, samples a second and seconds."""
RENDERS_PER_S = 10
"""Refreshes whose pictures are compared, a second."""
SIZE_PX = 192
"""Rows and columns of a picture of the face."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchVoiceConfig:
    """What to compare."""

    scenarios: Words = ()
    """Names of troubles, separated by commas; all by default."""
    seconds: float = 30.0
    """Length of each run, cellular ones six times as long; the trouble lasts the middle third."""

    def __post_init__(self) -> None:
        check_names("scenario", self.scenarios, BY_NAME)
        check_ranges(self, seconds=(9, 600))


class _Ear:
    """A receiver's voice, pulled every 20 ms.

    Attributes:
        sounds: What came out, 20 ms each.
        delays_s: How old each was when it left the loudspeaker; NaN where nothing was heard.
        counted: (time, played, concealed) after each tick.
        is_loud: Whether speech was in the last 20 ms, each time that `heard_us` was asked.
    """

    def __init__(self, packets: Sequence[tuple[float, Frame]]) -> None:
        self.sounds: list[FloatArray] = []
        self.delays_s: list[float] = []
        self.counted: list[tuple[float, int, int]] = []
        self.is_loud: list[bool] = []
        self._buffer, self._voice = JitterBuffer(OpusDecoder()), HeardVoice()
        self._waiting = deque(packets)

    def heard_us(self, now: float) -> int | None:
        """Play up to `now`; what is heard then, sender's clock."""
        buffer = self._buffer
        while (tick_s := (len(self.sounds) + DISPLAY_PHASE) * FRAME_S) <= now:
            while self._waiting and self._waiting[0][0] <= tick_s:
                arrived_s, packet = self._waiting.popleft()
                buffer.receive(packet, arrived_s)
            self.sounds.append(buffer.pull(tick_s))
            report, captured_s = buffer.report, math.nan
            if buffer.moment is not None:
                self._voice.receive(buffer.moment)
                captured_s = (buffer.moment[1] - CLOCK_OFFSET_US) / 1e6
            self.delays_s.append(tick_s - captured_s)
            self.counted.append((tick_s, report.played, report.concealed))
        self.is_loud.append(bool(self.sounds) and float(np.std(self.sounds[-1])) > SPOKEN_RMS)
        return self._voice.at(now)


def run_bench_voice(config: BenchVoiceConfig, avatar: Avatar) -> dict[str, Any]:
    """Run all scenarios.

    Raises:
        GraphicsError: No GL context; names the fix.
    """
    face, expressions = make_performance("talk").frame_at, ExpressionEncoder(avatar)
    chosen = [BY_NAME[name] for name in config.scenarios] or list(SCENARIOS)
    rows = []
    said: dict[int, tuple[FloatArray, list[tuple[float, Frame]]]] = {}
    with FaceRenderer(avatar, size_px=SIZE_PX, views=("front",)) as renderer:
        for scenario in chosen:
            if scenario.lasts not in said:
                sound = _speech(config.seconds * scenario.lasts)
                said[scenario.lasts] = sound, _packets(sound)
            sound, voice = said[scenario.lasts]
            encoder = LatentEncoder(fps=FPS)
            delivery = deliver(face, encoder, scenario, len(sound) / RATE_HZ, voice)
            ear = _Ear(delivery.voices)
            ticks = play(delivery, LatentDecoder(avatar), Playout(), ear.heard_us)
            rows.append(
                {
                    "condition": scenario.name,
                    "pesq": _pesq(sound, ear, delivery),
                    **_timing(ear, ticks, sound, delivery),
                    **_pictures(ticks, delivery, face, expressions, renderer),
                }
            )
            say(f"{scenario.name}: {scenario.note}")
    return report(config, rows, avatar=avatar.manifest.name)


def _pictures(
    ticks: Sequence[Tick],
    delivery: Delivery,
    face: Face,
    expressions: ExpressionEncoder,
    renderer: FaceRenderer,
) -> dict[str, Any]:
    """Error and longest standstill of the face in the troubled third."""
    troubled = [tick for tick in ticks if delivery.is_troubled(tick.now_s)]
    errors = []
    for tick in troubled[:: round(DISPLAY_HZ / RENDERS_PER_S)]:
        if tick.played is not None:
            true = face(tick.now_s - CALM.delay_s - tick.report.delay_s)
            pose = true.rotation, true.translation_m
            ((shown, _),) = renderer.draw(tick.played.sample.latent, *pose)
            ((wanted, _),) = renderer.draw(expressions.encode(true.arkit), *pose)
            errors.append(drawn_mse(shown, wanted))
    runs = groupby(troubled, key=lambda tick: tick.played and tick.played.captured_us)
    longest = max(sum(1 for _ in run) for _, run in runs)
    return {
        "face_mse": round(float(np.mean(errors)), 3) if errors else None,
        "face_still_ms": round(longest / DISPLAY_HZ * 1e3, 1),
    }


def _speech(seconds: float) -> FloatArray:
    """The shipped sentences again and again, in a room that is not quite silent."""
    size = int(seconds / FRAME_S) * FRAME
    room = np.random.default_rng(0).standard_normal(size).astype(np.float32)
    return np.resize(shipped_speech(), size) + ROOM_RMS * room


def _packets(sound: FloatArray) -> list[tuple[float, Frame]]:
    """The packets of a sound, of 40 ms, each sent when its last sample has been captured."""
    encoder = OpusEncoder(BITRATE_BPS)
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


def _pesq(sound: FloatArray, ear: _Ear, delivery: Delivery) -> float | None:
    """PESQ of the troubled third, the mean of its pieces of `SCORE_S`; None where nothing that
    sounds like an utterance is left."""
    from pesq import PesqError, pesq

    third = int(delivery.seconds / 3 * RATE_HZ)
    # Sample k of the sound leaves the loudspeaker at the first tick's time plus k samples.
    shift = round((np.nanmedian(ear.delays_s) - ear.counted[0][0]) * RATE_HZ)
    heard = np.concatenate(ear.sounds)[shift:]
    scores = []
    for begin in range(third, 2 * third, min(third, SCORE_S * RATE_HZ)):
        end = min(begin + SCORE_S * RATE_HZ, 2 * third)
        pair = sound[begin:end], np.pad(heard, (0, end))[begin:end]
        with suppress(PesqError):
            true, played = (resampled(each, RATE_HZ, SCORE_HZ) for each in pair)
            scores.append(float(pesq(SCORE_HZ, true, played, "wb")))
    return round(float(np.mean(scores)), 2) if scores else None


def _timing(
    ear: _Ear, ticks: Sequence[Tick], sound: FloatArray, delivery: Delivery
) -> dict[str, Any]:
    """Delay and skew of the troubled third, the skew of refreshes at which speech is heard."""
    frames = sound[: len(sound) // FRAME * FRAME].reshape(-1, FRAME)
    loud = np.sqrt(np.mean(np.square(frames), axis=1)) > SPOKEN_RMS
    counted = np.array(ear.counted)
    is_troubled = np.array([delivery.is_troubled(tick_s) for tick_s in counted[:, 0]])
    delays_s, counts = np.array(ear.delays_s)[is_troubled], counted[is_troubled]
    skews = []
    for tick, is_loud in zip(ticks, ear.is_loud, strict=True):
        if tick.played is None or tick.heard_us is None or not is_loud:
            continue
        if not delivery.is_troubled(tick.now_s):
            continue
        place = int((tick.heard_us - CLOCK_OFFSET_US) / 1e6 / FRAME_S)
        if 0 <= place < len(loud) and loud[place]:
            skews.append((tick.played.captured_us - tick.heard_us) / 1e6)
    played, concealed = (counts[-1] - counts[0])[1:]
    return {
        "mouth_to_ear_ms": summarise_ms(delays_s[~np.isnan(delays_s)].tolist()),
        "skew_ms": summarise_ms(map(abs, skews)),
        "concealed_ratio": round(float(concealed / max(played + concealed, 1)), 4),
    }
