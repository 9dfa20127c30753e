"""What sizes of sealed frames tell: whether somebody speaks, with and without padding.

    python scripts/sizes_tell.py

Generated performances (talk and listen, several players) are encoded for each shipped avatar at
30 frames a second, as `pica send` does, and cut into windows of 2 s. A window is speech when the
jaw moves (standard deviation of jawOpen above 0.05), stillness when it does not (below 0.005);
others are left out. What an observer gets is the size of each sealed frame, or that there was
none. AUC is the chance that a window of speech looks more like speech than one of stillness: 0.5
is a guess, 1 is certainty. `bytes` ranks windows by the sum of their sizes, `frames` by how many
came; `fit` is a linear discriminant over sum, number, mean, spread, largest and smallest size,
fitted to half of the players and judged on the other half.

``--voice`` looks at a voice instead: the sentences that ship, 4 s of every 8, in a room of -60 dB.
`speaks` ranks windows of 2 s by their bytes, `pauses` by how many packets came, `loud` the packets
of speech by their size: louder than the median or not, which is what words are made of.

What this does not show: real faces, other windows, an observer who knows the person.
"""

from __future__ import annotations

import argparse
import json
import sys

import numpy as np
import numpy.typing as npt

from pica_client.avatars.library import AvatarLibrary
from pica_client.e2ee.padding import MAX_BUCKET, pad, parse_buckets
from pica_client.sources import open_source
from pica_client.voice.opus import OpusEncoder
from pica_client.voice.packet import FRAME_S, FRAME_SAMPLES, PACKET_FRAMES, SAMPLE_RATE_HZ
from pica_client.voice.wav import shipped_speech
from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.avatar.streams import open_encoder
from pica_core.codec.latent_stream import StreamConfig

Array = npt.NDArray[np.float64]

FPS = 30
SECONDS = 60
WINDOW = 2 * FPS
SEALED_BYTES = 19
"""What sealing adds to a frame with full tags."""
BUCKETS = ("off", "16,32,64", "24,32,64", "32,64,256", "64,256")
SPEECH, STILL = 0.05, 0.005


def take(avatar: Avatar, source_name: str) -> tuple[Array, Array]:
    """Return the payload's size of each frame time (0: no frame), and how far the jaw is open."""
    source = open_source(source_name)
    faces = ExpressionEncoder(avatar)
    stream, _ = open_encoder(avatar, StreamConfig(fps=FPS), plain=False)
    sizes, jaw = np.zeros(SECONDS * FPS), np.zeros(SECONDS * FPS)
    for number in range(len(sizes)):
        frame = source.frame_at(number / FPS)
        jaw[number] = frame.arkit[ARKIT_INDEX["jawOpen"]]
        captured_us = round(number / FPS * 1e6)
        coded = stream.encode(
            faces.encode(frame.arkit), frame.rotation, frame.translation_m, captured_us
        )
        sizes[number] = -1 if coded is None else len(coded.payload)
    return sizes, jaw


def observed(sizes: Array, buckets: tuple[int, ...]) -> Array:
    """Return the sealed size of each frame time; 0 where no frame was sent."""
    padded = sizes
    if buckets:
        filled = [len(pad(bytes(int(max(size, 0))), buckets, MAX_BUCKET)) for size in sizes]
        padded = np.array(filled, np.float64)
    return np.where(sizes < 0, 0.0, padded + SEALED_BYTES)


def auc(speech: Array, still: Array) -> float:
    """Return the chance that one of the first is larger than one of the second; ties are half."""
    larger = (speech[:, None] > still[None]).mean() + 0.5 * (speech[:, None] == still[None]).mean()
    return float(max(larger, 1 - larger))


def features(window: Array) -> list[float]:
    """Return what an observer may look at in a window."""
    sent = window[window > 0]
    if not len(sent):
        return [0.0] * 6
    return [sent.sum(), len(sent), sent.mean(), sent.std(), sent.max(), sent.min()]


def judge(takes: list[tuple[int, Array, Array]], buckets: tuple[int, ...]) -> dict[str, float]:
    """Return rate and AUCs over all takes (player, sizes, jaw)."""
    rows, labels, players, sent_bytes, seconds = [], [], [], 0.0, 0.0
    for player, sizes, jaw in takes:
        seen = observed(sizes, buckets)
        sent_bytes += seen.sum()
        seconds += len(seen) / FPS
        for begin in range(0, len(seen) - WINDOW + 1, WINDOW):
            spread = jaw[begin : begin + WINDOW].std()
            if STILL <= spread <= SPEECH:
                continue
            rows.append(features(seen[begin : begin + WINDOW]))
            labels.append(spread > SPEECH)
            players.append(player)
    table, is_speech = np.array(rows), np.array(labels)
    is_fitted = np.array(players) % 2 == 0
    scaled = (table - table[is_fitted].mean(0)) / (table[is_fitted].std(0) + 1e-9)
    target = is_speech[is_fitted] - is_speech[is_fitted].mean()
    weights = np.linalg.lstsq(scaled[is_fitted], target, rcond=1e-6)[0]
    score, judged = (scaled @ weights)[~is_fitted], is_speech[~is_fitted]
    return {
        "kbit_per_s": round(sent_bytes * 8e-3 / seconds, 2),
        "speech": int(is_speech.sum()),
        "still": int((~is_speech).sum()),
        "bytes": round(auc(table[is_speech, 0], table[~is_speech, 0]), 3),
        "frames": round(auc(table[is_speech, 1], table[~is_speech, 1]), 3),
        "fit": round(auc(score[judged], score[~judged]), 3),
    }


def voice_row(*, is_sealed: bool, pad_to: int) -> dict[str, object]:
    """Return what the packets of one voice tell."""
    sound = np.resize(shipped_speech(), int(SECONDS / FRAME_S) * FRAME_SAMPLES)
    is_turn = np.arange(len(sound)) // (4 * SAMPLE_RATE_HZ) % 2 == 0
    room = np.random.default_rng(0).normal(0, 0.001, len(sound))
    sound = (sound * is_turn + room).astype(np.float32)
    encoder, size = OpusEncoder(is_constant=is_sealed), PACKET_FRAMES * FRAME_SAMPLES
    packets = [encoder.encode(part) for part in sound.reshape(-1, size)]
    padded = [0 if each is None else len(each) + 1 for each in packets]
    sizes = np.array([max(each, pad_to) if each else 0 for each in padded], np.float64)
    windows = sizes.reshape(-1, round(2 * SAMPLE_RATE_HZ / size))
    speaks = is_turn.reshape(len(windows), -1).all(1)
    sent = sizes > 0
    loud = sound.reshape(-1, size).std(1)
    is_said = sent & (loud > 0.005)
    is_loud = loud[is_said] > np.median(loud[is_said])
    counts = (windows > 0).sum(1).astype(np.float64)
    return {
        "voice": "sealed" if is_sealed else "open",
        "pad_to": pad_to,
        "sizes": len(set(sizes[sent])),
        "sizes of speech": len(set(sizes[is_said])),
        "kbit_per_s": round(float(sizes.sum()) * 8e-3 / SECONDS, 1),
        "speaks": round(auc(windows[speaks].sum(1), windows[~speaks].sum(1)), 3),
        "pauses": round(auc(counts[speaks], counts[~speaks]), 3),
        "loud": round(auc(sizes[is_said][is_loud], sizes[is_said][~is_loud]), 3),
    }


def main() -> None:
    """Read the command line, measure, print a JSON line for each padding."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--players", type=int, default=8, help="of each performance")
    parser.add_argument("--pad", nargs="*", default=BUCKETS, help="as pica send --pad")
    parser.add_argument("--voice", action="store_true", help="a voice instead of faces")
    options = parser.parse_args()
    if options.voice:
        for is_sealed, pad_to in ((False, 0), (True, 0), (True, 124)):
            print(json.dumps(voice_row(is_sealed=is_sealed, pad_to=pad_to)))
        return
    library, takes = AvatarLibrary(), []
    try:
        for name in library.names:
            avatar = library.load(library.find(name))
            for player in range(options.players):
                for manner in ("talk", "listen"):
                    takes.append((player, *take(avatar, f"performance:{manner}#{player}")))
            print(f"{name}: encoded", file=sys.stderr)
    finally:
        library.close()
    sent = np.concatenate([sizes[sizes >= 0] for _, sizes, _ in takes])
    shares = {str(share): int(np.percentile(sent, share)) for share in (5, 50, 95, 99, 100)}
    print(json.dumps({"takes": len(takes), "payload bytes by percentile": shares}))
    for text in options.pad:
        print(json.dumps({"pad": text, **judge(takes, parse_buckets(text))}))


if __name__ == "__main__":
    main()
