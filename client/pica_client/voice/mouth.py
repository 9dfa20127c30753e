"""A mouth that moves as the voice says, for a face whose tracker is lost, or that has none.

A small causal network hears 40 mel bands every 10 ms and names the shapes of jaw and lips: a linear
layer, a gated recurrent unit (Cho et al., EMNLP 2014), a linear layer. It hears `LOOK_AHEAD_S`
beyond the moment that it speaks of, for lips move before their sound. Its weights come from
a training that docs/voice.md describes.
"""

import base64
from collections import deque
from dataclasses import replace
from typing import Final

import numpy as np

from pica_client.sources.source import make_performance
from pica_client.voice.opus import SAMPLE_RATE_HZ, level_of
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT, ExpressionFrame
from pica_core.files import packaged_json
from pica_core.types import FloatArray

HOP: Final = 480
"""Samples from one answer to the next: 10 ms."""
WINDOW: Final = 1200
NUM_BANDS: Final = 40
LOOK_AHEAD_HOPS: Final = 4
DELAY_S: Final = LOOK_AHEAD_HOPS * HOP / SAMPLE_RATE_HZ + WINDOW / 2 / SAMPLE_RATE_HZ
"""How much later than its sound a mouth is known: 52.5 ms."""
SHAPES: Final = (
    *("jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthRollLower", "mouthRollUpper"),
    *("mouthPress", "mouthStretch", "mouthSmile", "mouthLowerDown", "mouthUpperUp"),
)
"""What the network names; both sides of a shape move alike."""
QUIETEST: Final = 1e-7
"""Energy of a band below which there is nothing to hear."""
LEVEL_DECAY: Final = 0.9995
"""The loudest of late is forgotten with 20 s: a voice is judged by its own loudness."""

SEAM_S: Final = 0.2
"""How long the tracker's mouth takes to become the voice's, and the other way round."""
SILENT_AFTER_S: Final = 20.0
"""No face is sent after this much silence without tracking: the chair may be empty."""
SPEAKING_LEVEL: Final = 45
"""Decibels below full scale: a louder sound is speech (chosen: a quiet room is below 60)."""
KEPT_S: Final = 1.0
"""Sound kept while the tracker sees the face: the network begins there when it does not (chosen:
longer than the network remembers)."""
KEPT_HOPS: Final = 128
STEP_S: Final = HOP / SAMPLE_RATE_HZ

_COLUMNS = [
    [ARKIT_INDEX[name] for name in (shape, f"{shape}Left", f"{shape}Right") if name in ARKIT_INDEX]
    for shape in SHAPES
]
MOUTH: Final = np.zeros(NUM_ARKIT, bool)
"""Which of the 52 shapes belong to jaw and mouth."""
for _name, _index in ARKIT_INDEX.items():
    MOUTH[_index] = _name.startswith(("jaw", "mouth", "tongue"))


def mel_filters() -> FloatArray:
    """Triangles of equal width on the mel scale, 80 to 7600 Hz: weights of the power spectrum,
    float32 ``[bins, 40]``."""
    mel = np.linspace(2595 * np.log10(1 + 80 / 700), 2595 * np.log10(1 + 7600 / 700), NUM_BANDS + 2)
    edges_hz = 700 * (10 ** (mel / 2595) - 1)
    bins_hz = np.fft.rfftfreq(WINDOW, 1 / SAMPLE_RATE_HZ)[:, None]
    low, middle, high = edges_hz[:-2], edges_hz[1:-1], edges_hz[2:]
    rising, falling = (bins_hz - low) / (middle - low), (high - bins_hz) / (high - middle)
    weights = np.clip(np.minimum(rising, falling), 0, None)
    return np.asarray(weights / np.maximum(weights.sum(0), 1e-9), np.float32)


class SpeechFeatures:
    """The network's input, computed as sound comes in."""

    def __init__(self) -> None:
        self._filters = mel_filters()
        self._window = np.hanning(WINDOW).astype(np.float32)
        self._kept = np.zeros(WINDOW - HOP, np.float32)
        self._loudest = np.log(np.float32(QUIETEST))

    def push(self, pcm: FloatArray) -> FloatArray:
        """Take sound as `MouthFromVoice.push` does, and return log energies of the bands below the
        loudest of late, about [-2, 0]. float32 ``[n, 40]``."""
        sound = np.concatenate([self._kept, pcm])
        self._kept = sound[len(sound) - (WINDOW - HOP) :]
        frames = np.lib.stride_tricks.sliding_window_view(sound, WINDOW)[::HOP]
        power = np.abs(np.fft.rfft(frames * self._window)).astype(np.float32) ** 2 / WINDOW
        bands = np.log(power @ self._filters + np.float32(QUIETEST))
        floor = np.log(np.float32(QUIETEST))
        for row in bands:
            loudest = floor + (self._loudest - floor) * np.float32(LEVEL_DECAY)
            self._loudest = max(loudest, row.max())
            # However quiet the room, its noise is not brought up to the loudness of a voice.
            row -= max(self._loudest, floor + 6)
        return np.asarray(bands / 8, np.float32)


def _matrix(shape: list[int], halfs: str) -> FloatArray:
    """A matrix whose columns stand one after the other as half floats in base64."""
    columns = np.frombuffer(base64.b64decode(halfs), "<f2")
    return columns.reshape(shape, order="F").astype(np.float32)


class MouthFromVoice:
    """Hears one voice, and says how the mouth stands."""

    def __init__(self) -> None:
        weights = packaged_json("pica_client.voice", "mouth.json")
        self._w = {name: _matrix(**stored) for name, stored in weights.items()}
        self._features = SpeechFeatures()
        self._state = np.zeros(len(self._w["u"]), np.float32)
        self.push(np.zeros(SAMPLE_RATE_HZ, np.float32))  # it has listened to silence before

    def push(self, pcm: FloatArray) -> FloatArray:
        """Take sound.

        Args:
            pcm: Whole hops at 48 kHz, within [-1, 1]. float32 ``[480 * n]``.

        Returns:
            The 52 shapes, those of jaw and mouth set, for every hop: the mouth `DELAY_S` before the
            hop's end. float32 ``[n, 52]``.
        """
        w, state = self._w, self._state
        hidden = np.maximum(self._features.push(pcm) @ w["in"] + w["in_bias"], 0)
        gates = hidden @ w["w"] + w["w_bias"]
        states = np.empty((len(gates), len(state)), np.float32)
        size = len(state)
        for step, gate in enumerate(gates):
            past = state @ w["u"] + w["u_bias"]
            reset = _sigmoid(gate[:size] + past[:size])
            keep = _sigmoid(gate[size : 2 * size] + past[size : 2 * size])
            new = np.tanh(gate[2 * size :] + reset * past[2 * size :])
            states[step] = state = (1 - keep) * new + keep * state
        self._state = state
        answers = np.clip(states @ w["out"] + w["out_bias"], 0, 1)
        arkit = np.zeros((len(gates), NUM_ARKIT), np.float32)
        for column, targets in enumerate(_COLUMNS):
            arkit[:, targets] = answers[:, column : column + 1]
        return arkit


def _sigmoid(value: FloatArray) -> FloatArray:
    return np.asarray(1 / (1 + np.exp(-value)), np.float32)


class SpokenFace:
    """Fills in the losses of a source by the voice of the same person.

    The mouth is the voice's; eyes, brows and head are those of a listener. The seam is
    blended. While the tracker sees the face, sound is kept and the network rests.

    Args:
        stays: Whether there is a face however long there is silence.
    """

    def __init__(self, *, stays: bool = False) -> None:
        self._silent_after_s = np.inf if stays else SILENT_AFTER_S
        self._idle = make_performance("listen")
        self._net = MouthFromVoice()
        self._kept: deque[tuple[FloatArray, float]] = deque()
        self._mouths: deque[tuple[float, FloatArray]] = deque(maxlen=KEPT_HOPS)
        self._spoke_s = -np.inf
        self._weight, self._weight_s = 0.0, -np.inf
        self._own_s = -np.inf

    def hear(self, pcm: FloatArray, time_s: float) -> None:
        """Take sound of this person.

        Args:
            pcm: Whole hops at 48 kHz, within [-1, 1]. float32 ``[480 * n]``.
            time_s: When its first sample was heard, in the source's time.
        """
        self._kept.append((pcm, time_s))
        while self._kept[0][1] < time_s - KEPT_S:
            self._kept.popleft()
        if level_of(pcm) < SPEAKING_LEVEL:
            self._spoke_s = time_s

    def fill(self, frame: ExpressionFrame, time_s: float) -> ExpressionFrame:
        """The face to show.

        Args:
            frame: What the source shows, a face or none.
            time_s: The moment that it was asked for, in the source's time; rising.

        Returns:
            The source's face, or one that speaks, or something between in the seam; none while
            no face is seen and no voice heard.
        """
        fills = not frame.has_face and time_s - self._spoke_s <= self._silent_after_s
        step = min(max(time_s - self._weight_s, 0.0), SEAM_S) / SEAM_S
        self._weight = min(max(self._weight + (step if fills else -step), 0.0), 1.0)
        self._weight_s = time_s
        # A filled face is as old as its mouth, so that it meets its sound at the receivers.
        own_s = frame.captured_us / 1e6 if frame.has_face else time_s - DELAY_S
        own_s = self._own_s = max(own_s, self._own_s)  # two moments are not shown in turn
        if self._weight == 0.0:
            return frame
        idle, weight = self._idle.frame_at(time_s), np.float32(self._weight)
        spoken = np.where(MOUTH, self._mouth_at(own_s), idle.arkit)
        return replace(
            frame,
            captured_us=round(own_s * 1e6),
            arkit=(frame.arkit + weight * (spoken - frame.arkit)).astype(np.float32),
            rotation=frame.rotation + weight * (idle.rotation - frame.rotation),
            has_face=True,
        )

    def _mouth_at(self, time_s: float) -> FloatArray:
        """The 52 shapes, jaw and mouth set; coming to rest where nothing is heard."""
        while self._kept:
            pcm, begin_s = self._kept.popleft()
            ends_s = begin_s + STEP_S * np.arange(1, len(pcm) // HOP + 1) - DELAY_S
            self._mouths.extend(zip(ends_s.tolist(), self._net.push(pcm), strict=True))
        for heard_s, mouth in reversed(self._mouths):
            if heard_s <= time_s:
                late = max(time_s - heard_s - STEP_S, 0.0) / SEAM_S
                return mouth * np.float32(max(1 - late, 0.0))
        return np.zeros(len(MOUTH), np.float32)
