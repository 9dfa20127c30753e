"""A mouth that moves as the voice says, for a face that no tracker sees.

A small causal network hears 40 mel bands every 10 ms and names the shapes of jaw and lips: a linear
layer, a gated recurrent unit (Cho et al., EMNLP 2014), a linear layer. It hears `LOOK_AHEAD_S`
beyond the moment that it speaks of, for lips move before their sound. Its weights come from
a training that docs/voice.md describes.
"""

from importlib import resources
from typing import Final

import numpy as np

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.types import FloatArray

SAMPLE_RATE: Final = 48_000
HOP: Final = 480
"""Samples from one answer to the next: 10 ms."""
WINDOW: Final = 1200
NUM_BANDS: Final = 40
LOOK_AHEAD_HOPS: Final = 4
DELAY_S: Final = LOOK_AHEAD_HOPS * HOP / SAMPLE_RATE + WINDOW / 2 / SAMPLE_RATE
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
    bins_hz = np.fft.rfftfreq(WINDOW, 1 / SAMPLE_RATE)[:, None]
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


class MouthFromVoice:
    """Hears one voice, and says how the mouth stands."""

    def __init__(self) -> None:
        path = resources.files("pica_client.voice") / "mouth.npz"
        with path.open("rb") as file, np.load(file) as stored:
            self._w = {name: stored[name].astype(np.float32) for name in stored.files}
        self._features = SpeechFeatures()
        self._state = np.zeros(len(self._w["u"]), np.float32)
        self.push(np.zeros(SAMPLE_RATE, np.float32))  # it has listened to silence before

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
