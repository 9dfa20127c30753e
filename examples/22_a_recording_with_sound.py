"""Record pictures with sound, in step, and look at what came out.

You learn how a recording keeps its times: pictures have those at which they were drawn, sound those
at which it left the loudspeaker, or was said; a talker adds to a `Soundtrack`, on any thread, and
the `Recorder` takes from it what belongs to the pictures. Here a flash and a tone begin together.

    python examples/22_a_recording_with_sound.py [OUT]
"""

import sys
from pathlib import Path

import av
import numpy as np

from pica_client.ui.recorder import Recorder, Soundtrack
from pica_client.voice.opus import FRAME_SAMPLES, SAMPLE_RATE_HZ

BEGIN_S, SECONDS, FPS, TONE_S = 50.0, 3.0, 30, 51.0

path = Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "flash.mp4"
path.parent.mkdir(parents=True, exist_ok=True)
track = Soundtrack()
with Recorder(path, (64, 64), lambda: track) as recorder:
    for number in range(round(SECONDS * FPS)):
        now = BEGIN_S + number / FPS
        shade = 255 if now >= TONE_S else 30
        recorder.write(np.full((64, 64, 4), shade, np.uint8), now)
        # A mixer tells of 20 ms at a time, and when they leave the loudspeaker.
        for part in range(round(50 * number / FPS), round(50 * (number + 1) / FPS)):
            leaves_s = BEGIN_S + 0.02 * part
            times = leaves_s + np.arange(FRAME_SAMPLES) / SAMPLE_RATE_HZ
            tone = 0.3 * np.sin(2 * np.pi * 440 * times) * (times >= TONE_S)
            track.add("Ada", tone.astype(np.float32), leaves_s)

with av.open(str(path)) as container:
    shades = [
        (frame.time, frame.to_ndarray(format="gray").mean()) for frame in container.decode(video=0)
    ]
with av.open(str(path)) as container:
    sound = np.concatenate([frame.to_ndarray()[0] for frame in container.decode(audio=0)])
flash_s = next(time_s for time_s, shade in shades if shade > 200)
tone_s = float(np.argmax(np.abs(sound) > 0.1)) / SAMPLE_RATE_HZ
print(f"{path}: {len(shades)} pictures, {len(sound) / SAMPLE_RATE_HZ:.2f} s of sound")
print(f"the flash is at {flash_s:.3f} s, the tone at {tone_s:.3f} s")
