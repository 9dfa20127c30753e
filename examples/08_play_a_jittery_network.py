"""Play a stream that arrives through a bad network, on a clock of our own.

You learn how to use the playout buffer alone. It is pure: times are arguments, so nothing waits
and every run is the same. It learns how much later than usual frames come, and shows them so
much later.
"""

import numpy as np

from pica_client.playout.buffer import Playout
from pica_core.codec.latent_stream import LatentSample
from pica_protocol.frames import Frame

FPS, SECONDS, DISPLAY_HZ = 30, 20, 60
rng = np.random.default_rng(1)


def face(captured_s: float) -> LatentSample:
    """A face whose first number says when it was captured."""
    latent = np.full((8, 8, 4), captured_s, np.float32)
    zero = np.zeros(3, np.float32)
    return LatentSample(latent=latent, rotation=zero, translation_m=zero)


print("jitter ms  delay ms  concealed  largest step ms")
for jitter_ms in (0, 20, 80):
    captured_s = np.arange(FPS * SECONDS) / FPS
    # 30 ms of way, and a waiting time that is short mostly and long at times.
    arrived_s = captured_s + 0.03 + rng.exponential(jitter_ms / 1000 / 3, len(captured_s))
    playout, following, before, steps = Playout(), 0, None, []
    order = np.argsort(arrived_s)
    for now in np.arange(0, SECONDS, 1 / DISPLAY_HZ).tolist():
        while following < len(order) and arrived_s[order[following]] <= now:
            index = int(order[following])
            captured_us = round(captured_s[index] * 1e6)
            frame = Frame(stream=1, sequence=index, captured_us=captured_us, payload=b"")
            playout.receive(frame, face(captured_s[index]), now)
            following += 1
        played = playout.sample_at(now)
        if played is not None:
            shown_s = float(played.sample.latent[0, 0, 0])
            if before is not None and now > 2:  # the first seconds are for learning
                steps.append(shown_s - before)
            before = shown_s
    assert before is not None
    report = playout.report()
    print(
        f"{jitter_ms:9d} {(now - before) * 1000:9.1f} {report.concealed_ratio:9.1%}"
        f" {max(steps) * 1000:12.1f}"
    )
