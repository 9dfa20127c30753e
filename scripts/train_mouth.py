"""Trains the mouth that follows a voice, on speech whose sounds are known to the millisecond.

    python scripts/train_mouth.py [--minutes 100] [--epochs 70] [--report FILE]

eSpeak NG (Debian: ``espeak-ng``) speaks the sentences of this documentation with thirty voices and
says when each sound begins. Each sound has a mouth; mouths blend as Cohen and Massaro let them
(Models and Techniques in Computer Animation, 1993): each has a dominance that falls off in time,
and the lips of a p or an f yield to nobody. The network learns them from the sound, made louder and
quieter, dull and bright, with noise of a room in it. One voice in six and one sentence in eight are
kept aside; docs/results/mouth.md is made of those, beside a rule that knows the level alone and a
linear map of the bands. Real voices differ from synthetic ones; nothing here measures how much.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import re
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from pica_client.voice.mouth import (
    HOP,
    LOOK_AHEAD_HOPS,
    NUM_BANDS,
    SAMPLE_RATE,
    SHAPES,
    WINDOW,
    SpeechFeatures,
)

ROOT = Path(__file__).resolve().parent.parent
VOICES = [
    f"{language}+{variant}"
    for language in ("gmw/en-US", "gmw/en", "gmw/en-GB-scotland", "gmw/en-GB-x-rp", "gmw/en-029")
    for variant in ("f1", "f2", "f3", "f5", "m1", "m2", "m3", "m6", "m8", "klatt2")
]
KEPT_VOICES = ["gmw/en-US+f4", "gmw/en+m7", "gmw/en-GB-x-rp+linda", "gmw/en-US+klatt4"]
RATE = 22_050

# In the order of `SHAPES`.
MOUTHS: dict[str, tuple[list[float], float, float]] = {
    # sounds: the mouth, its hold on the jaw, its hold on the lips
    "": ([0] * 11, 0.5, 0.5),
    "pbm": ([0.08, 0.08, 0, 0.05, 0.25, 0.2, 0.45, 0, 0, 0, 0], 3.0, 9.0),
    "fvɱʋ": ([0.1, 0, 0, 0, 0.45, 0, 0.1, 0.05, 0, 0, 0.25], 2.0, 8.0),
    "θð": ([0.16, 0, 0, 0, 0, 0, 0, 0.1, 0, 0.25, 0.12], 1.0, 1.0),
    "tdnɾɖʈɳ": ([0.14, 0, 0, 0, 0, 0, 0, 0.1, 0, 0.2, 0.08], 1.0, 0.5),
    "szɕʑ": ([0.06, 0, 0, 0, 0, 0, 0, 0.28, 0.1, 0.32, 0.15], 2.5, 1.5),
    "lɫɭ": ([0.2, 0, 0, 0, 0, 0, 0, 0.08, 0, 0.2, 0.08], 0.9, 0.5),
    "ʃʒ": ([0.08, 0, 0.5, 0.2, 0, 0, 0, 0, 0, 0.2, 0.18], 2.5, 4.0),
    "ɹrʁɻ": ([0.13, 0, 0.3, 0.25, 0, 0, 0, 0, 0, 0.1, 0.05], 0.9, 1.2),
    "kɡgŋhxçɣʔqc": ([0.18, 0, 0, 0, 0, 0, 0, 0.05, 0, 0.12, 0.05], 0.6, 0.3),
    "jʎɲ": ([0.1, 0, 0, 0, 0, 0, 0, 0.25, 0.2, 0.15, 0.05], 0.8, 0.8),
    "wɥ": ([0.1, 0, 0.2, 0.75, 0, 0, 0, 0, 0, 0, 0], 1.2, 5.0),
    "uʊyʏʉ": ([0.15, 0, 0.25, 0.62, 0, 0, 0, 0, 0, 0, 0], 1.0, 3.0),
    "oɔøœɒ": ([0.35, 0, 0.45, 0.32, 0, 0, 0, 0, 0, 0.08, 0], 1.0, 2.0),
    "aɑɐ": ([0.58, 0, 0, 0, 0, 0, 0, 0.05, 0, 0.28, 0.15], 1.2, 1.0),
    "æ": ([0.52, 0, 0, 0, 0, 0, 0, 0.22, 0.08, 0.34, 0.2], 1.2, 1.0),
    "eɛ": ([0.34, 0, 0, 0, 0, 0, 0, 0.2, 0.1, 0.25, 0.12], 1.0, 1.0),
    "əɜʌɚɝ": ([0.28, 0, 0.05, 0.03, 0, 0, 0, 0.05, 0, 0.16, 0.08], 0.8, 0.6),
    "iɪɨ": ([0.15, 0, 0, 0, 0, 0, 0, 0.32, 0.25, 0.2, 0.08], 1.0, 1.0),
}
BEFORE_S, AFTER_S = 0.05, 0.04
"""How fast a mouth's dominance falls off before and after its sound (chosen)."""


class Sound(NamedTuple):
    """A sound of speech and when it begins."""

    begin_s: float
    ipa: str


class _Id(ctypes.Union):
    _fields_ = [("number", ctypes.c_int), ("name", ctypes.c_char_p), ("text", ctypes.c_char * 8)]


class _Event(ctypes.Structure):
    _fields_ = [
        ("type", ctypes.c_int),
        ("unique", ctypes.c_uint),
        ("text_position", ctypes.c_int),
        ("length", ctypes.c_int),
        ("audio_ms", ctypes.c_int),
        ("sample", ctypes.c_int),
        ("user", ctypes.c_void_p),
        ("id", _Id),
    ]


class Speaker:
    """eSpeak NG, called so that it tells its sounds."""

    def __init__(self) -> None:
        self._lib = ctypes.CDLL("libespeak-ng.so.1")
        # Return the sound (2); phoneme events in IPA (1 + 2), and do not exit on errors.
        assert self._lib.espeak_Initialize(2, 0, None, 0x8003) == RATE

    def say(
        self, text: str, voice: str, words_a_minute: int, pitch: int
    ) -> tuple[Any, list[Sound]]:
        """Speak: samples at 22.05 kHz within [-1, 1], and the sounds."""
        pcm: list[Any] = []
        sounds: list[Sound] = []

        def take(wave: Any, count: int, events: Any) -> int:
            if count > 0:
                pcm.append(np.ctypeslib.as_array(wave, (count,)).copy())
            at = 0
            while events[at].type:
                if events[at].type == 7:
                    ipa = events[at].id.text.decode("utf-8", "ignore")
                    sounds.append(Sound(events[at].sample / RATE, ipa))
                at += 1
            return 0

        kind = ctypes.CFUNCTYPE(
            ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.POINTER(_Event)
        )
        callback = kind(take)
        self._lib.espeak_SetSynthCallback(callback)
        if self._lib.espeak_SetVoiceByName(voice.encode()) != 0:
            raise SystemExit(f"eSpeak NG has no voice {voice}")
        self._lib.espeak_SetParameter(1, words_a_minute, 0)
        self._lib.espeak_SetParameter(3, pitch, 0)
        data = text.encode()
        self._lib.espeak_Synth(data, len(data) + 1, 0, 0, 0, 1, None, None)
        self._lib.espeak_Synchronize()
        return np.concatenate(pcm).astype(np.float32) / 32768, sounds


def mouths_of(sounds: list[Sound], num_hops: int) -> Any:
    """The true mouth at the middle of each hop's window. float32 ``[num_hops, 11]``."""
    times_s = (np.arange(num_hops) * HOP - (WINDOW / 2 - HOP)) / SAMPLE_RATE
    total = np.zeros((num_hops, 11))
    weight = np.full((num_hops, 11), 1e-6)
    ends = [sound.begin_s for sound in sounds[1:]] + [num_hops * HOP / SAMPLE_RATE]
    for sound, end_s in zip(sounds, ends, strict=True):
        parts = [c for c in sound.ipa if any(c in key for key in MOUTHS if key)]
        parts = parts[:2] if len(parts) > 1 else parts or [""]
        step_s = (end_s - sound.begin_s) / len(parts)
        for place, part in enumerate(parts):
            mouth, jaw, lips = next(MOUTHS[k] for k in MOUTHS if (part in k if part else not k))
            begin_s = sound.begin_s + place * step_s
            early = np.maximum(begin_s - times_s, 0) / BEFORE_S
            late = np.maximum(times_s - begin_s - step_s, 0) / AFTER_S
            fall = np.exp(-((early + late) ** 2))[:, None]
            dominance = fall * np.array([jaw] + [lips] * 10)
            total += dominance * np.array(mouth)
            weight += dominance
    return (total / weight).astype(np.float32)


def sentences() -> list[str]:
    """The prose of the documentation."""
    found = []
    for path in sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")]):
        for line in re.split(r"(?<=[.!?])\s", re.sub(r"\n(?!\n)", " ", path.read_text("utf-8"))):
            if 25 < len(line) < 160 and re.fullmatch(r"[A-Z][A-Za-z0-9 ,.;:'()-]+", line):
                found.append(line)
    return sorted(set(found))


def is_kept(sentence: str) -> bool:
    """Whether a sentence is for the measurement alone."""
    return zlib.crc32(sentence.encode()) % 8 == 0


def disturbed(pcm: Any, rng: np.random.Generator) -> Any:
    """The sound as microphones and rooms make it."""
    spectrum = np.fft.rfft(pcm)
    hz = np.fft.rfftfreq(len(pcm), 1 / SAMPLE_RATE)
    tilt_db = rng.uniform(-9, 9) * np.log2(np.maximum(hz, 60) / 1000) / 3
    pcm = np.fft.irfft(spectrum * 10 ** (tilt_db / 20), len(pcm))
    white = np.fft.rfft(rng.standard_normal(len(pcm)))
    noise = np.fft.irfft(white / np.sqrt(np.maximum(hz, 50)), len(pcm))
    noise *= np.std(pcm) / np.std(noise) * 10 ** (-rng.uniform(8, 50) / 20)
    pcm = pcm + noise
    return (pcm * 10 ** (rng.uniform(-18, 0) / 20) / np.abs(pcm).max()).astype(np.float32)


def spoken(
    speaker: Speaker, texts: list[str], voices: list[str], minutes: float, seed: int, clean: bool
) -> list[tuple[Any, Any]]:
    """Pairs of bands ``[n, 40]`` and true mouths ``[n, 11]``, a sentence each."""
    rng = np.random.default_rng(seed)
    found: list[tuple[Any, Any]] = []
    hops = 0
    while hops < minutes * 6000:
        text, voice = rng.choice(texts), rng.choice(voices)
        pcm, sounds = speaker.say(
            str(text), str(voice), int(rng.integers(130, 220)), int(rng.integers(25, 80))
        )
        lead = rng.uniform(0.1, 0.8)
        num = int((lead + 0.3) * SAMPLE_RATE + len(pcm) * SAMPLE_RATE / RATE) // HOP
        at = np.arange(num * HOP) / SAMPLE_RATE - lead
        loud = np.interp(at * RATE, np.arange(len(pcm)), pcm, left=0, right=0)
        shifted = [Sound(0.0, ""), *(Sound(each.begin_s + lead, each.ipa) for each in sounds)]
        target = mouths_of(shifted, num)
        sound = loud.astype(np.float32) * 0.5 if clean else disturbed(loud, rng)
        found.append((SpeechFeatures().push(sound), target))
        hops += num
    return found


class Net(torch.nn.Module):
    """The network as it is trained; `pica_client.voice.mouth` runs the same in NumPy."""

    def __init__(self) -> None:
        super().__init__()
        self.into = torch.nn.Linear(NUM_BANDS, 64)
        self.past = torch.nn.GRU(64, 96, batch_first=True)
        self.out = torch.nn.Linear(96, len(SHAPES))

    def forward(self, bands: torch.Tensor) -> torch.Tensor:
        """Mouths ``[B, n, 11]`` from bands ``[B, n, 40]``, `LOOK_AHEAD_HOPS` late."""
        result: torch.Tensor = self.out(self.past(torch.relu(self.into(bands)))[0])
        return result


def batches(data: list[tuple[Any, Any]], length: int, rng: np.random.Generator) -> Any:
    """Pieces of equal length from sentences in a row, 32 at once."""
    order = rng.permutation(len(data))
    bands = np.concatenate([data[i][0] for i in order])
    mouths = np.concatenate([data[i][1] for i in order])
    count = len(bands) // length
    bands = bands[: count * length].reshape(count, length, -1)
    mouths = mouths[: count * length].reshape(count, length, -1)
    for begin in range(0, count - 31, 32):
        yield (
            torch.from_numpy(bands[begin : begin + 32]),
            torch.from_numpy(mouths[begin : begin + 32]),
        )


def train(data: list[tuple[Any, Any]], epochs: int) -> Net:
    """Learn: errors count by how much a shape moves, and its speed counts, too."""
    torch.manual_seed(0)
    net, rng = Net(), np.random.default_rng(1)
    scale = torch.from_numpy(1 / np.concatenate([m for _, m in data]).std(0)).float()
    optimiser = torch.optim.Adam(net.parameters(), 2e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, epochs)
    ahead = LOOK_AHEAD_HOPS
    for epoch in range(epochs):
        losses = []
        for bands, mouths in batches(data, 200, rng):
            error = (net(bands)[:, ahead:] - mouths[:, :-ahead])[:, 20:] * scale
            loss = (error**2).mean() + 4 * (error.diff(dim=1) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            optimiser.step()
            losses.append(loss.item())
        schedule.step()
        print(f"epoch {epoch + 1} of {epochs}: {np.mean(losses):.4f}", flush=True)
    return net


def save(net: Net, path: Path) -> None:
    """Write the weights as half floats, as the running network reads them."""
    state = {name: value.detach().numpy() for name, value in net.state_dict().items()}
    arrays = {
        "in": state["into.weight"].T,
        "in_bias": state["into.bias"],
        "w": state["past.weight_ih_l0"].T,
        "w_bias": state["past.bias_ih_l0"],
        "u": state["past.weight_hh_l0"].T,
        "u_bias": state["past.bias_hh_l0"],
        "out": state["out.weight"].T,
        "out_bias": state["out.bias"],
    }
    # torch's order is reset, update, new, as in the running network.
    np.savez(path, **{name: array.astype(np.float16) for name, array in arrays.items()})


def fit(train_x: Any, train_y: Any, ridge: float) -> Any:
    """Least squares with a constant."""
    x = np.c_[train_x, np.ones(len(train_x))]
    return np.linalg.solve(x.T @ x + ridge * np.eye(x.shape[1]), x.T @ train_y)


def errors(data: list[tuple[Any, Any]], answer: Any) -> dict[str, float]:
    """Root mean square errors of jaw and lips, how they follow, and how closed closures are."""
    said, true = [], []
    for bands, mouths in data:
        said.append(answer(bands)[LOOK_AHEAD_HOPS:])
        true.append(mouths[: len(mouths) - LOOK_AHEAD_HOPS])
    a, b = np.clip(np.concatenate(said), 0, 1), np.concatenate(true)
    lips = [i for i, name in enumerate(SHAPES) if name != "jawOpen"]
    press = SHAPES.index("mouthPress")
    closed, is_closed = b[:, press] > 0.3, a[:, press] > 0.15
    moving = b[:, lips].std(0) > 1e-3
    follow = [np.corrcoef(a[:, i] + 1e-9 * b[:, i], b[:, i])[0, 1] for i in np.array(lips)[moving]]
    return {
        "jaw_rmse": float(np.sqrt(np.mean((a[:, 0] - b[:, 0]) ** 2))),
        "lips_rmse": float(np.sqrt(np.mean((a[:, lips] - b[:, lips]) ** 2))),
        "jaw_correlation": float(np.corrcoef(a[:, 0], b[:, 0])[0, 1]),
        "lips_correlation": float(np.nanmean(follow)),
        "closures_found": float(is_closed[closed].mean()),
        "closures_false": float(is_closed[b[:, press] < 0.05].mean()),
    }


def main() -> None:
    """Train, save and measure."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--minutes", type=float, default=100)
    parser.add_argument("--epochs", type=int, default=70)
    parser.add_argument("--out", type=Path, default=ROOT / "client/pica_client/voice/mouth.npz")
    parser.add_argument("--report", type=Path, help="where the measurement goes, as JSON")
    options = parser.parse_args()
    speaker = Speaker()
    texts = sentences()
    learn = [text for text in texts if not is_kept(text)]
    keep = [text for text in texts if is_kept(text)]
    print(f"{len(learn)} sentences to learn from, {len(keep)} kept")
    data = spoken(speaker, learn, VOICES, options.minutes, 1, clean=False)
    net = train(data, options.epochs)
    save(net, options.out)
    bands = np.concatenate([b[LOOK_AHEAD_HOPS:] for b, _ in data])
    mouths = np.concatenate([m[: len(m) - LOOK_AHEAD_HOPS] for _, m in data])

    def level_of(each: Any) -> Any:
        return each.max(1, keepdims=True)

    by_level, by_bands = fit(level_of(bands), mouths, 1e-3), fit(bands, mouths, 1.0)
    answers = {
        "network": lambda x: net(torch.from_numpy(x)[None])[0].detach().numpy(),
        "linear map of the bands": lambda x: np.c_[x, np.ones(len(x))] @ by_bands,
        "level alone": lambda x: np.c_[level_of(x), np.ones(len(x))] @ by_level,
    }
    tests = {
        "sentences kept": spoken(speaker, keep, VOICES, 3, 2, clean=True),
        "sentences and voices kept": spoken(speaker, keep, KEPT_VOICES, 3, 3, clean=True),
        "the same, with noise and tilt": spoken(speaker, keep, KEPT_VOICES, 3, 4, clean=False),
        "German, a voice kept": spoken(speaker, keep, ["gmw/de+f4"], 2, 5, clean=True),
    }
    rows = [
        {"test": test, "answer": name, **errors(data, answer)}
        for test, data in tests.items()
        for name, answer in answers.items()
    ]
    for row in rows:
        print(json.dumps({k: round(v, 3) if isinstance(v, float) else v for k, v in row.items()}))
    if options.report:
        options.report.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
