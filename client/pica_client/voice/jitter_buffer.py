"""From voice packets as the network delivers them to an even sound. Pure: `now` is an argument.

    receive(packet, now)      a packet arrived
    pull(now, latency_s)      the next 20 ms for the loudspeaker, which they leave `latency_s` later
    moment                    when they leave it, and when they were captured

Theory of operation. Sequence, capture time and transit are judged by what the playout of faces
judges them by (`playout.sender_clock`), so jumps, drift and tricks of strangers end
there. What was captured at t should be played at

    t + fastest transit + delay               delay = one frame + jitter, 30 to 200 ms

A delay that is no longer needed is given up slowly, in `RELEASE_S`: one that goes down in each
pause, and up again with the next late packet, tears more words than it saves time.

    what is there                            what is played                        its time
    ---------------------------------------  ------------------------------------  ----------------
    the next packet                          it                                    goes on
    a later one, the next is lost            concealment by the codec, 100 ms      goes on
    the next, captured after a silence       silence until it is due               free
    nothing, and it was quiet                silence                               free
    nothing, in the middle of speech         concealment, 100 ms; then silence     stands still
    much, and it is far too old              the newest: a leap

In silence time is free: there the delay changes, in what is not sent at once, in what is quiet by
what is there. After a stall speech goes on where it stopped, as long as it is not `LEAP_S`
behind, and catches up in its pauses.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from pica_client.errors import VoiceError
from pica_client.playout.sender_clock import RESTART_FRAMES, ReceivedFrame, SenderClock, Transit
from pica_client.voice.opus import FRAME_S, OpusDecoder
from pica_client.voice.opus import FRAME_SAMPLES as FRAME
from pica_client.voice.opus import SAMPLE_RATE_HZ as RATE_HZ
from pica_core.types import Array, FloatArray
from pica_protocol.frames import Frame

MAX_CONCEALED = 5
"""Frames in a row that the codec conceals: 100 ms, by when its sound has faded."""
MAX_PACKETS = 64
"""Packets that wait; the oldest is dropped beyond (chosen: 1.3 s, more than is ever played)."""
CODEC_DELAY_S = 0.0065
"""What comes out of Opus was put in so much before the packet's first sample (its look-ahead)."""
SILENT_S = 1.5
"""Without a packet for so long nothing is heard that a face could be in step with (chosen: three
refreshes of discontinuous transmission, 400 ms each)."""
QUIET_RATIO, QUIET_RMS = 2.0, 0.001
"""A frame is quiet below so many times the noise floor, or below -60 dB of full scale."""
FIRST_FLOOR_RMS = 0.002
"""Noise floor that is believed before anything has been heard: -54 dB."""
FLOOR_RISE = 1.01
"""How much the noise floor may rise with each frame: threefold in two seconds."""
LOUDEST = 0.01
"""Root mean square above which no frame is quiet: -40 dB of full scale (chosen)."""
CEILING_S = 0.2
"""Longest delay, one frame included."""
LEAST_JITTER_S = 0.01
"""Jitter that is always waited for (chosen: docs/results/voice.md)."""
JITTER_QUANTILE = 0.97
"""Share of delays that are waited for."""
RELEASE_S = 5.0
"""Time in which two thirds of a delay that is no longer needed are given up."""
LEAP_S = 0.2
"""Speech this far behind is left out (measured on a car's cellular link: with 0.35, a tenth of what
is heard is older than 0.4 s, with 0.16 to 0.26 hardly any, PESQ the same; from 0.16 down speech on
a way with jitter alone is torn)."""
LEAST_ERROR_S = 0.003
"""Wrong delay that is changed."""
FADE = 240
"""Samples of a cross-fade: 5 ms."""

NUM_MOMENTS = 64
"""Moments of a voice that are known: 1.3 s, more than a loudspeaker's latency."""
HELD_S = 0.5
"""A voice of which nothing was mixed for so long is not heard any more (chosen)."""

Moment = tuple[float, float, float]
"""When 20 ms of a voice leave the loudspeaker, our clock, and when its first and its last sample
were captured, microseconds of the sender's."""


class HeardVoice:
    """Which moment of one voice is heard, by what was mixed of it."""

    def __init__(self) -> None:
        self._mixed: deque[Moment] = deque(maxlen=NUM_MOMENTS)

    def receive(self, moment: Moment) -> None:
        """Take what was mixed last."""
        self._mixed.append(moment)

    def at(self, now: float) -> int | None:
        """The moment that leaves the loudspeaker at `now`, microseconds of the sender's clock; None
        while there is none. What stands still, as in a stall, is heard at one moment."""
        for leaves_s, first, last in reversed(tuple(self._mixed)):  # another thread adds to it
            if leaves_s <= now:
                share = min((now - leaves_s) / FRAME_S, 2.0)
                return round(first + share * (last - first)) if now < leaves_s + HELD_S else None
        return None


@dataclass(kw_only=True, slots=True)
class JitterBufferReport:
    """Counters since the voice began."""

    lost: int = 0
    """Packets that never came, came too late, or were refused by the codec."""
    played: int = 0
    """Frames decoded from packets."""
    concealed: int = 0
    """Frames made up where speech should have been."""

    @property
    def concealed_ratio(self) -> float:
        """Share of speech that was made up."""
        speech = self.played + self.concealed
        return self.concealed / speech if speech else 0.0


class JitterBuffer:
    """The jitter buffer of one voice; see the module for how it works.

    Attributes:
        report: How the voice came in.
        waiting: Packets to be played, by number; at most `MAX_PACKETS`.
        moment: When the last tick leaves the loudspeaker, and its samples' moments; None while
            nothing is heard.
    """

    def __init__(self, decoder: OpusDecoder) -> None:
        self.report = JitterBufferReport()
        self.waiting: list[ReceivedFrame] = []
        self.moment: Moment | None = None
        self._decoder = decoder
        self._sender = SenderClock(quantile=JITTER_QUANTILE)
        self._wait_s = self._fastest_s = math.inf  # to sound, and here, with the clocks' offset
        self._last_number: int | None = None
        self._end_s = 0.0  # of what the packets up to the last one told
        self._packet_s = FRAME_S  # how long the last one was
        self._fifo = np.zeros((2, 0))  # samples, and the moment of each on the time line
        self._is_quiet, self._floor_rms = True, FIRST_FLOOR_RMS
        self._num_concealed = 0  # in a row
        self._is_starved = False  # silence stands where speech should be
        self._offset_us = 0.0
        self._last_arrival_s = self._aimed_s = -math.inf

    def receive(self, packet: Frame, now: float) -> None:
        """Take a packet that arrived at `now`."""
        self._last_arrival_s = now
        received = self._sender.receive(packet, now)
        transit, last = self._sender.transit, self._last_number
        if received is None or transit is None:
            return
        if last is not None and received.number > last + RESTART_FRAMES:
            # It was muted, and begins again: what waits is forgotten.
            self.waiting.clear()
            self._is_quiet, self._is_starved, self._num_concealed = True, False, 0
            self._last_number = None
        transit.receive(received.media_s, now)
        self._aim(transit, now)
        self.waiting.append(received)
        del self.waiting[:-MAX_PACKETS]

    def pull(self, now: float, latency_s: float = 0.0) -> FloatArray:
        """The next `FRAME` samples, float32.

        Args:
            now: Our clock. Ticks come about every 20 ms; what they come too fast or too slow is
                drift of the loudspeaker's clock, and is stretched away.
            latency_s: Until the first sample leaves the loudspeaker.
        """
        if self._wait_s == math.inf:  # no packet has come yet
            return np.zeros(FRAME, np.float32)
        should_s = now - self._wait_s
        self._leap(should_s)
        self._fill(FRAME, should_s)
        self._stretch(should_s)
        self._fill(FRAME, should_s)
        out, self._fifo = self._fifo[:, :FRAME], self._fifo[:, FRAME:]
        first, last = ((out[1, [0, -1]] - CODEC_DELAY_S) * 1e6 + self._offset_us).tolist()
        is_heard = now - self._last_arrival_s <= SILENT_S
        self.moment = (now + latency_s, first, last) if is_heard else None
        sound: FloatArray = out[0].astype(np.float32)
        return sound

    def _aim(self, transit: Transit, now: float) -> None:
        """Wait longer at once, and less slowly.

        What is released is the whole wait: when the fastest packets of calmer times are forgotten,
        `fastest_s` rises and `jitter_s` falls by as much, and the sound goes on unchanged. A way
        that becomes shorter is followed at once.
        """
        elapsed_s, self._aimed_s = max(now - self._aimed_s, 0.0), now
        room_s = CEILING_S - FRAME_S
        begin_s = transit.fastest_s + FRAME_S
        needed_s = begin_s + min(transit.jitter_s, room_s)
        enough_s = begin_s + min(max(transit.jitter_s, LEAST_JITTER_S), room_s)
        if self._wait_s == math.inf:
            self._wait_s = enough_s
        else:
            self._wait_s += min(transit.fastest_s - self._fastest_s, 0.0)
        self._fastest_s = transit.fastest_s
        excess_s = max(self._wait_s - enough_s, 0.0)
        released_s = excess_s * (1 - math.exp(-elapsed_s / RELEASE_S))
        self._wait_s = max(self._wait_s - released_s, needed_s)

    def _leap(self, should_s: float) -> None:
        """Leave out what is far too old, if there is something newer."""
        if not self.waiting or self._behind(should_s) <= LEAP_S:
            return
        while len(self.waiting) > 1 and self.waiting[0].media_s + self._packet_s <= should_s:
            self.report.lost += 1
            del self.waiting[0]
        self._fifo = self._fifo[:, :0]
        self._last_number, self._end_s = self.waiting[0].number - 1, self.waiting[0].media_s

    def _behind(self, should_s: float) -> float:
        """How much later than it should be the next sound is played."""
        waits_s = self._fifo.shape[1] / RATE_HZ
        if self.waiting and not self._is_gap:
            return should_s + waits_s - self.waiting[0].media_s
        return should_s - float(self._fifo[1, 0]) if waits_s else 0.0

    @property
    def _is_gap(self) -> bool:
        """Whether the next packet was captured after a silence."""
        return self.waiting[0].media_s > self._end_s + 0.25 * FRAME_S

    def _fill(self, num_samples: int, should_s: float) -> None:
        """Make sure that so many samples can be played."""
        while (have := self._fifo.shape[1]) < num_samples:
            self._append_next(should_s + have / RATE_HZ)

    def _append_next(self, due_s: float) -> None:
        """Append something that should be played at that moment of the time line."""
        if not self.waiting:
            if not self._is_quiet and self._num_concealed < MAX_CONCEALED:
                self._conceal(self._end_s)
                return
            self._is_starved |= not self._is_quiet
            begin_s, rate = (self._end_s, 0.0) if self._is_starved else (due_s, 1.0)
            self._append_silence(begin_s, FRAME, rate)
            return
        following, last = self.waiting[0], self._last_number
        num_missing = 0 if last is None else following.number - last - 1
        # What was made up while nothing was there stands for what is lost, as turns out now.
        num_frames = min(round(num_missing * self._packet_s / FRAME_S), MAX_CONCEALED)
        if self._is_gap and self._num_concealed < num_frames:
            self._conceal(self._end_s)
            self._end_s += FRAME_S
        elif (last is None or self._is_gap) and following.media_s > due_s + 0.001:
            self.report.lost += num_missing
            self._last_number = following.number - 1
            wait_s = following.media_s - due_s
            self._append_silence(due_s, min(round(wait_s * RATE_HZ), FRAME))
        else:
            self._decode_next()

    def _append(self, sound: Array, begin_s: float, rate: float = 1.0) -> None:
        moments = begin_s + np.arange(len(sound)) * (rate / RATE_HZ)
        self._fifo = np.concatenate([self._fifo, np.stack([sound, moments])], axis=1)

    def _append_silence(self, begin_s: float, num_samples: int, rate: float = 1.0) -> None:
        self.report.concealed += self._is_starved
        self._append(np.zeros(num_samples), begin_s, rate)

    def _conceal(self, begin_s: float) -> None:
        self._num_concealed += 1
        self.report.concealed += 1
        rate = 1.0 if self.waiting else 0.0  # with nothing there, time stands still
        self._append(self._decoder.decode(None), begin_s, rate)

    def _decode_next(self) -> None:
        packet, last = self.waiting.pop(0), self._last_number
        self.report.lost += 0 if last is None else packet.number - last - 1
        self._last_number = packet.number
        self._offset_us = packet.captured_us - packet.media_s * 1e6
        self._is_starved = False
        try:
            sound = self._decoder.decode(packet.payload)
        except VoiceError:
            self.report.lost += 1
            self._end_s = packet.media_s + FRAME_S
            self._conceal(packet.media_s)
            return
        self._packet_s = len(sound) / RATE_HZ
        self._end_s = packet.media_s + self._packet_s
        self._num_concealed = 0
        self.report.played += len(sound) // FRAME
        rms = _rms(sound[-FRAME:])
        self._floor_rms = min(rms, self._floor_rms * FLOOR_RISE + 1e-6)
        self._is_quiet = self._sounds_quiet(rms)
        self._append(sound, packet.media_s)

    def _sounds_quiet(self, rms: float) -> bool:
        return rms <= min(max(QUIET_RATIO * self._floor_rms, QUIET_RMS), LOUDEST)

    def _stretch(self, should_s: float) -> None:
        """Go a step towards the delay that should be, where nothing is said."""
        behind_s = self._behind(should_s)
        if abs(behind_s) < LEAST_ERROR_S:
            return
        if behind_s > 0:  # what is left out must be there
            while self._fifo.shape[1] < 2 * FRAME and self.waiting and not self._is_gap:
                self._decode_next()
        fifo = self._fifo
        size = min(round(abs(behind_s) * RATE_HZ), fifo.shape[1] - FADE)
        if size <= 0 or not self._sounds_quiet(_rms(fifo[0, : size + FADE])):
            return
        end, begin = (0, size) if behind_s > 0 else (size, 0)
        faded = crossfade(fifo[:, end : end + FADE], fifo[:, begin : begin + FADE])
        self._fifo = np.concatenate([fifo[:, :end], faded, fifo[:, begin + FADE :]], axis=1)


def crossfade(before: Array, after: Array) -> Array:
    """Go over from one sound to another of the same length; the last axis is time."""
    share = np.linspace(0, 1, before.shape[-1], endpoint=False, dtype=before.dtype)
    faded: Array = before + share * (after - before)
    return faded


def _rms(sound: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(sound))))
