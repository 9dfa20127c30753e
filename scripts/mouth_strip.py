"""Pictures of a mouth that follows a voice, beside the truth and beside a rule that knows loudness.

    python scripts/mouth_strip.py OUT.png      (Debian: espeak-ng)

A sentence that nothing was learnt from, by a voice that nothing was learnt from: eight moments, and
the jaw and the pressing of the lips all along.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from train_mouth import RATE, Sound, Speaker, mouths_of

from pica_client.render.thumbnail import draw_thumbnail
from pica_client.voice.mouth import (
    HOP,
    LOOK_AHEAD_HOPS,
    SAMPLE_RATE,
    SHAPES,
    MouthFromVoice,
    SpeechFeatures,
)
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.file import load_avatar
from pica_core.avatar.shipped import shipped_avatar_files

SENTENCE = "Papa may move the big blue boat, five of you saw."
VOICE = "gmw/en-US+f4"


def main() -> None:
    """Draw."""
    pcm, sounds = Speaker().say(SENTENCE, VOICE, 150, 50)
    lead = 0.2
    num = int((lead + 0.3) * SAMPLE_RATE + len(pcm) * SAMPLE_RATE / RATE) // HOP
    at = (np.arange(num * HOP) / SAMPLE_RATE - lead) * RATE
    sound = np.interp(at, np.arange(len(pcm)), pcm, left=0, right=0).astype(np.float32) * 0.5
    shifted = [Sound(0.0, ""), *(Sound(each.begin_s + lead, each.ipa) for each in sounds)]
    true = np.zeros((num, NUM_ARKIT), np.float32)
    for column, mouth in enumerate(mouths_of(shifted, num).T):
        for name in (SHAPES[column], f"{SHAPES[column]}Left", f"{SHAPES[column]}Right"):
            if name in ARKIT_INDEX:
                true[:, ARKIT_INDEX[name]] = mouth
    voice = np.roll(MouthFromVoice().push(sound), -LOOK_AHEAD_HOPS, 0)
    level = SpeechFeatures().push(sound).max(1)
    jaw, press = ARKIT_INDEX["jawOpen"], ARKIT_INDEX["mouthPressLeft"]
    factors = np.polyfit(level, true[:, jaw], 1)
    loud = np.zeros_like(true)
    loud[:, jaw] = np.clip(np.polyval(factors, level), 0, 1)

    avatar = load_avatar(shipped_avatar_files()[0])
    spoken = [each for each in shifted if each.ipa and each.ipa[0] in "pɑmubɪfɔ"]
    chosen = [spoken[i] for i in np.linspace(0, len(spoken) - 1, 8).round().astype(int)]
    figure = plt.figure(figsize=(12, 7.5))
    grid = figure.add_gridspec(5, 8, height_ratios=(1, 1, 1, 0.8, 0.8), wspace=0.03, hspace=0.12)
    for column, each in enumerate(chosen):
        hop = int((each.begin_s + 0.03) * SAMPLE_RATE / HOP) + 1
        rows = (("true", true), ("from the voice", voice), ("loudness", loud))
        for row, (name, values) in enumerate(rows):
            axes = figure.add_subplot(grid[row, column])
            image = draw_thumbnail(avatar, (256, 256), arkit=values[hop])
            axes.imshow(image[110:230, 60:196])
            axes.set_xticks([])
            axes.set_yticks([])
            if row == 0:
                axes.set_title(f"/{each.ipa}/  {each.begin_s:.2f} s")
            if column == 0:
                axes.set_ylabel(name)
    time_s = np.arange(num) * HOP / SAMPLE_RATE
    for row, (name, index) in enumerate((("jaw", jaw), ("press", press))):
        axes = figure.add_subplot(grid[3 + row, :])
        axes.plot(time_s, true[:, index], "k", lw=1.2, label="true")
        axes.plot(time_s, voice[:, index], "#0072B2", lw=1.2, label="from the voice")
        axes.plot(time_s, loud[:, index], "#D55E00", lw=0.8, label="loudness")
        axes.set_ylabel(name)
        axes.set_xlim(0, time_s[-1])
    axes.set_xlabel("seconds")
    axes.legend(ncol=3, fontsize=8)
    figure.savefig(Path(sys.argv[1]), dpi=80, bbox_inches="tight")


if __name__ == "__main__":
    main()
