"""A face that goes on speaking when its tracker is lost, or when there is none."""

from bisect import bisect_right
from collections import deque
from dataclasses import replace
from typing import Final

import numpy as np

from pica_client.sources.performances import make_performance
from pica_client.voice.mouth import DELAY_S, HOP, MOUTH, SAMPLE_RATE, MouthFromVoice
from pica_core.avatar.arkit import ExpressionFrame
from pica_core.types import FloatArray

SEAM_S: Final = 0.2
"""How long the tracker's mouth takes to become the voice's, and the other way round."""
SILENT_AFTER_S: Final = 20.0
"""Who has said nothing for so long, and is not seen, may have left the chair: there is no face."""
SPEAKING: Final = 0.04
"""A jaw that the voice opens further than this speaks; 1 is wide open."""
KEPT_HOPS: Final = 128
STEP_S: Final = HOP / SAMPLE_RATE


class SpokenMouth:
    """How the mouth stands by a voice, for some time back."""

    def __init__(self) -> None:
        self._net = MouthFromVoice()
        self._times_s: deque[float] = deque(maxlen=KEPT_HOPS)
        self._mouths: deque[FloatArray] = deque(maxlen=KEPT_HOPS)
        self._rest = np.zeros(len(MOUTH), np.float32)
        self.spoke_s = -np.inf

    @property
    def newest_s(self) -> float:
        """Up to when it is known."""
        return self._times_s[-1] if self._times_s else -np.inf

    def hear(self, pcm: FloatArray, time_s: float) -> None:
        """Take sound.

        Args:
            pcm: Whole hops at 48 kHz, within [-1, 1]. float32 ``[480 * n]``.
            time_s: When its first sample was heard; the mouths have the same clock.
        """
        for place, mouth in enumerate(self._net.push(pcm)):
            at_s = time_s + (place + 1) * STEP_S - DELAY_S
            if at_s <= self.newest_s:
                continue
            self._times_s.append(at_s)
            self._mouths.append(mouth)
            if mouth.max() > SPEAKING:
                self.spoke_s = at_s

    def at(self, time_s: float) -> FloatArray:
        """The 52 shapes, jaw and mouth set, between two hops; at rest where nothing is heard."""
        after = bisect_right(self._times_s, time_s)
        if after == 0:
            return self._rest
        if after == len(self._times_s):
            late = (time_s - self._times_s[-1]) / SEAM_S
            return self._mouths[-1] * np.float32(max(1 - late, 0.0))
        begin_s, end_s = self._times_s[after - 1], self._times_s[after]
        before, behind = self._mouths[after - 1], self._mouths[after]
        if end_s - begin_s > 2 * STEP_S:  # nothing was sent between: silence
            return before * np.float32(max(1 - (time_s - begin_s) / SEAM_S, 0.0))
        share = np.float32((time_s - begin_s) / (end_s - begin_s))
        return before + share * (behind - before)


class SpokenFace:
    """Fills in the losses of a source by the voice of the same person.

    The mouth is the voice's; eyes, brows and head are those of somebody who listens. The seam is
    blended.
    """

    def __init__(self) -> None:
        self._idle = make_performance("listen")
        self._mouth = SpokenMouth()
        self._weight, self._weight_s = 0.0, -np.inf
        self._own_s = -np.inf

    def hear(self, pcm: FloatArray, time_s: float) -> None:
        """Take sound of this person, in the source's time; see `SpokenMouth.hear`."""
        self._mouth.hear(pcm, time_s)

    def fill(self, frame: ExpressionFrame, time_s: float) -> ExpressionFrame:
        """The face to show.

        Args:
            frame: What the source shows, a face or none.
            time_s: The moment that it was asked for, in the source's time; rising.

        Returns:
            The source's face, or one that speaks, or something between in the seam; none while
            nobody is seen or heard.
        """
        fills = not frame.has_face and time_s - self._mouth.spoke_s < SILENT_AFTER_S
        step = min(max(time_s - self._weight_s, 0.0), SEAM_S) / SEAM_S
        self._weight = min(max(self._weight + (step if fills else -step), 0.0), 1.0)
        self._weight_s = time_s
        # A filled face is as old as its mouth, so that it meets its sound at the receivers.
        own_s = frame.captured_us / 1e6 if frame.has_face else time_s - DELAY_S
        own_s = self._own_s = max(own_s, self._own_s)  # two moments are not shown in turn
        if self._weight == 0.0:
            return frame
        idle = self._idle.frame_at(time_s)
        spoken = np.where(MOUTH, self._mouth.at(own_s), idle.arkit)
        if self._weight == 1.0:
            arkit, rotation = spoken, idle.rotation
        else:
            seen = frame.arkit
            arkit = seen + np.float32(self._weight) * (spoken - seen)
            rotation = frame.rotation + np.float32(self._weight) * (idle.rotation - frame.rotation)
        return replace(
            frame,
            captured_us=round(own_s * 1e6),
            arkit=arkit.astype(np.float32),
            rotation=rotation,
            has_face=True,
        )
