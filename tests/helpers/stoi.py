"""How much of speech can be understood: STOI (Taal et al., IEEE TASLP 19, 2011)."""

import numpy as np

from pica_client.voice.source import resampled
from pica_core.types import FloatArray

RATE_HZ, FRAME, FFT, SEGMENT = 10_000, 256, 512, 30
QUIET_DB, CLIP_DB = 40, 15
_HZ = np.fft.rfftfreq(FFT, 1 / RATE_HZ)[:, None]
_CENTRES_HZ = 150 * 2 ** (np.arange(15) / 3)
_BANDS = (_HZ >= _CENTRES_HZ * 2 ** (-1 / 6)) & (_HZ < _CENTRES_HZ * 2 ** (1 / 6))


def stoi(said: FloatArray, heard: FloatArray) -> float:
    """From 0 to 1, of sounds ``[n]`` of 48 kHz in step."""
    both = [resampled(each, 48_000, RATE_HZ) for each in (said, heard)]
    frames = [np.lib.stride_tricks.sliding_window_view(each, FRAME)[:: FRAME // 2] for each in both]
    frames = [each * np.hanning(FRAME + 2)[1:-1].astype(np.float32) for each in frames]
    levels_db = 20 * np.log10(np.linalg.norm(frames[0], axis=1) + 1e-9)
    kept = levels_db > levels_db.max() - QUIET_DB
    clean, other = (
        np.lib.stride_tricks.sliding_window_view(
            np.sqrt(np.abs(np.fft.rfft(each[kept], FFT)) ** 2 @ _BANDS), SEGMENT, axis=0
        )
        for each in frames
    )
    norms = [np.linalg.norm(each, axis=2, keepdims=True) + 1e-9 for each in (clean, other)]
    other = np.minimum(other * norms[0] / norms[1], clean * (1 + 10 ** (CLIP_DB / 20)))
    clean, other = (each - each.mean(axis=2, keepdims=True) for each in (clean, other))
    products = (clean * other).sum(axis=2)
    lengths = np.linalg.norm(clean, axis=2) * np.linalg.norm(other, axis=2) + 1e-9
    return float((products / lengths).mean())
