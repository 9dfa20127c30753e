"""What a bad network does to the faces of a real call: two more receivers and a comparison.

The *reference* is connected to the relay directly and keeps every frame: the undisturbed stream.
The *display* sits behind the bad network and samples its faces `DISPLAY_HZ` times a second, as
a viewer would. After the call some of what the display saw is rendered and compared with what the
reference knows of the same peer, on the clock that all processes of this machine share.

The figures stand in ``docs/benches.md``. What it does not show: the loss of the format itself,
which both streams share.
"""

import asyncio
import bisect
from collections import defaultdict, deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pica_client.avatars.library import AvatarLibrary
from pica_client.bench.head import FaceRenderer
from pica_client.call.call import Call
from pica_client.call.faces import FaceState
from pica_client.local_call.local_call import ROOM
from pica_client.playout.config import PlayoutConfig
from pica_client.playout.motion import blend
from pica_client.render.drawing import drawn_mse
from pica_client.stats import percentile, summarise_ms
from pica_client.transport.config import LinkConfig
from pica_client.transport.receiver import Receiver
from pica_core.codec.latent_sample import LatentSample

DISPLAY_HZ = 60.0
MAX_SHOWN = 30_000
"""Faces of the display kept, 1 KB each; drops the oldest: 100 s of five peers."""
MAX_REFERENCE = 20_000
"""Frames of each peer kept for comparison; drops the oldest: 11 minutes."""
RENDERED_PER_PEER = 40
"""Faces that are rendered, evenly spread (chosen: seconds of rendering in software)."""
SIZE_PX = 192


class Shown(NamedTuple):
    """One face as the display had it."""

    now_us: int
    """The moment, by this machine's clock, as times of capture are."""
    face: FaceState
    sample: LatentSample

    @property
    def age_s(self) -> float:
        """Seconds since it was captured."""
        return (self.now_us - self.face.captured_us) / 1e6


class TrueFace:
    """The undisturbed stream of one peer, as a function of the sender's time."""

    def __init__(self) -> None:
        self._times_us: deque[int] = deque(maxlen=MAX_REFERENCE)
        self._samples: deque[LatentSample] = deque(maxlen=MAX_REFERENCE)

    def add(self, captured_us: int, sample: LatentSample) -> None:
        """Take the next frame."""
        self._times_us.append(captured_us)
        self._samples.append(sample)

    def at(self, time_us: int) -> LatentSample | None:
        """The face at a moment, between two frames; None before the first and after the last."""
        after = bisect.bisect_left(self._times_us, time_us)
        if after == 0 or after == len(self._times_us):
            return None
        begin, end = self._samples[after - 1], self._samples[after]
        begin_us, end_us = self._times_us[after - 1], self._times_us[after]
        if begin.is_still:  # nothing moved until shortly before the next frame
            return begin
        return blend(begin, end, (time_us - begin_us) / (end_us - begin_us))


class CallComparison:
    """Both receivers. Let `run` run beside the call, then `compare`."""

    def __init__(
        self,
        url: str,
        impaired_url: str,
        library: AvatarLibrary,
        playout: PlayoutConfig,
        secret_file: Path | None = None,
    ) -> None:
        """Prepare.

        Args:
            impaired_url: The way to it through the bad network.
            playout: How the display plays.
        """
        link = LinkConfig(room=ROOM, connect_timeout_s=20.0, secret_file=secret_file)
        self._library = library
        reference = replace(link, url=url, name="reference")
        self._reference = Receiver(reference, Call(library))
        display = replace(link, url=impaired_url, name="display")
        self._display = Receiver(display, Call(library, playout))
        self._true: defaultdict[str, TrueFace] = defaultdict(TrueFace)
        # Drops its oldest when full.
        self._shown: deque[Shown] = deque(maxlen=MAX_SHOWN)

    async def run(self) -> None:
        """Watch until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            for receiver in (self._reference, self._display):
                tasks.create_task(receiver.run())
            tasks.create_task(self._watch())

    def begin_window(self, now: float) -> None:
        """Let the comparison begin here."""
        self._shown.clear()
        self._display.call.begin_window(now)

    def compare(self) -> dict[str, Any]:
        """Render what the display showed, and say how far off it was.

        Raises:
            GraphicsError: No GL context; names the fix.
        """
        rows = []
        by_avatar: dict[str, dict[str, list[Shown]]] = defaultdict(lambda: defaultdict(list))
        for shown in self._shown:
            by_avatar[shown.face.avatar_id][shown.face.name].append(shown)
        for avatar_id, by_name in sorted(by_avatar.items()):
            avatar = self._library.load(avatar_id)
            with FaceRenderer(avatar, size_px=SIZE_PX, views=("front",)) as renderer:
                for name, faces in by_name.items():
                    rows.append(_compare(renderer, faces, self._true[name]))
        means: dict[str, float | None] = {}
        for figure in ("mse_delayed", "mse_now", "largest_step"):
            found = [row[figure] for row in rows if figure in row]
            means[figure] = round(float(np.mean(found)), 3) if found else None
        fresh = [shown.face.status == "live" for shown in self._shown]
        return means | {
            "renders": sum(int(row.get("renders", 0)) for row in rows),
            "concealed_ratio": round(1 - float(np.mean(fresh)), 4) if fresh else None,
            "age_ms": summarise_ms(shown.age_s for shown in self._shown),
        }

    async def _watch(self) -> None:
        loop = asyncio.get_running_loop()
        next_s = loop.time()
        while True:
            next_s = max(next_s + 1 / DISPLAY_HZ, loop.time())
            await asyncio.sleep(next_s - loop.time())
            now = loop.time()
            for due in self._reference.call.due_frames(now):
                self._true[due.name].add(due.frame.captured_us, due.frame.sample)
            for face in self._display.call.faces(now):
                if face.latent is not None:
                    sample = LatentSample(
                        latent=face.latent, rotation=face.rotation, translation_m=face.translation_m
                    )
                    self._shown.append(Shown(round(now * 1e6), face, sample))


def _compare(renderer: FaceRenderer, faces: Sequence[Shown], true: TrueFace) -> dict[str, float]:
    """The errors of one peer; empty if the reference saw nothing of it."""
    usual_us = round(percentile(sorted(face.age_s for face in faces), 50) * 1e6)
    errors = []
    for face in faces[:: max(len(faces) // RENDERED_PER_PEER, 1)]:
        delayed, now = true.at(face.now_us - usual_us), true.at(face.now_us)
        if delayed is None or now is None:
            continue
        drawn, *wanted = map(renderer.draw_sample, (face.sample, delayed, now))
        errors.append([drawn_mse(drawn, each) for each in wanted])
    if not errors:
        return {}
    mse_delayed, mse_now = np.mean(errors, axis=0).tolist()
    row = {"mse_delayed": mse_delayed, "mse_now": mse_now, "renders": len(errors)}
    undisturbed = [true.at(face.now_us - usual_us) for face in faces]
    true_step = _largest_step(renderer, [sample for sample in undisturbed if sample is not None])
    if true_step > 0:
        shown_step = _largest_step(renderer, [face.sample for face in faces])
        row["largest_step"] = (shown_step / true_step) ** 0.5
    return row


def _largest_step(renderer: FaceRenderer, samples: Sequence[LatentSample]) -> float:
    """MSE between the two successive faces whose latents differ most; 0 if there are not two."""
    if len(samples) < 2:
        return 0.0
    return renderer.largest_step_mse(samples, np.stack([sample.latent for sample in samples]))
