"""Faces that make room for voices on a way that is too narrow for both. Pure.

A relay learns that a way is narrow when its socket is full: by then the queue in front of the
bottleneck is long, and every voice waits in it. Who receives hears it earlier. Packets of a voice
then come later and later than the fastest of them; jitter makes some late, a standing queue all of
them. So of each `WINDOW_S` the least late packet counts (as in CoDel, RFC 8289):

    above `STEP_S`                                          the fastest are sought anew
    above `LATE_S`, and not better than the window before   the lowest layer of all faces alone,
                                                            and if that does not help, no faces
    so still, twice `SETTLE_S` after the last face          no face fills it: the sender is later
                                                            than before, as by another microphone;
                                                            the fastest are sought anew
    below `FRESH_S` for the patience                        one layer more

The patience doubles when a layer more was one too many.
"""

import math
from typing import Final

from pica_client.call.layer_subscription import NOTHING
from pica_protocol.limits import MAX_LAYER

TOP_LAYER: Final = 2
"""Above it there is nothing to leave out first: streams have three layers."""
LATE_S: Final = 0.08
"""A standing queue (chosen: twice a packet, and words are still answered at once)."""
FRESH_S: Final = 0.04
STEP_S: Final = 1.0
"""Not a queue but a step of the sender's clock, as after a sleep (chosen: at a queue that grows
faces have yielded long before)."""
WINDOW_S: Final = 0.25
SETTLE_S: Final = 0.8
"""Until less is seen to help: a request, and the queue before it."""
MIN_PACKETS: Final = 3
"""Fewer in a window say nothing: nobody speaks."""
MEMORY_S: Final = 20.0
"""The fastest packet is remembered for one to two times that (chosen: clocks drift by 1 ms)."""
MIN_PATIENCE_S: Final = 8.0
MAX_PATIENCE_S: Final = 64.0
MAX_STREAMS: Final = 64
"""Voices whose fastest packet is remembered; beyond it all are forgotten."""


class _Fastest:
    """The fastest transit of one voice of late."""

    def __init__(self, transit_s: float, now: float) -> None:
        self._before_s = self._current_s = transit_s
        self._since_s = now

    def lateness_s(self, transit_s: float, now: float) -> float:
        if now - self._since_s > MEMORY_S:
            self._before_s, self._current_s, self._since_s = self._current_s, transit_s, now
        self._current_s = min(self._current_s, transit_s)
        return transit_s - min(self._before_s, self._current_s)


class YieldingFaces:
    """Says up to which layer there is room for faces.

    Attributes:
        max_layer: The highest layer of every face; `NOTHING` for voices alone.
    """

    def __init__(self) -> None:
        self.max_layer = MAX_LAYER
        self._fastest: dict[str, _Fastest] = {}
        self._window_s, self._num_packets = -math.inf, 0
        self._least_s = self._before_s = math.inf
        self._since_s = self._raised_s = self._lowered_s = -math.inf
        self._patience_s = MIN_PATIENCE_S
        self._yielded_s = math.inf
        """How late voices were when faces last made way."""

    def receive(self, peer_id: str, captured_us: int, now: float) -> bool:
        """Take note of a packet of somebody's voice; return whether `max_layer` has changed."""
        transit_s = now - captured_us / 1e6
        fastest = self._fastest.get(peer_id)
        if fastest is None:
            if len(self._fastest) >= MAX_STREAMS:
                self._fastest.clear()
            fastest = self._fastest[peer_id] = _Fastest(transit_s, now)
        self._least_s = min(self._least_s, fastest.lateness_s(transit_s, now))
        self._num_packets += 1
        if now - self._window_s < WINDOW_S:
            return False
        before = self.max_layer
        if self._num_packets >= MIN_PACKETS:
            if self._least_s > STEP_S:
                self._fastest.clear()
            else:
                self._judge(self._least_s, now)
                self._before_s = self._least_s
        self._window_s, self._num_packets, self._least_s = now, 0, math.inf
        return self.max_layer != before

    def _judge(self, standing_s: float, now: float) -> None:
        if standing_s > FRESH_S:
            self._since_s = now
        if standing_s > LATE_S and standing_s > 0.9 * self._before_s:
            if self.max_layer == NOTHING:
                is_settled = now - self._lowered_s > 2 * SETTLE_S
                if is_settled and standing_s > 0.9 * self._yielded_s:
                    self._fastest.clear()
                return
            if now - self._lowered_s < SETTLE_S:
                return
            if now - self._raised_s < MIN_PATIENCE_S:
                self._patience_s = min(2 * self._patience_s, MAX_PATIENCE_S)
            self.max_layer = 0 if self.max_layer > 0 else NOTHING
            self._lowered_s, self._yielded_s = now, standing_s
        elif now - self._since_s >= self._patience_s and self.max_layer < MAX_LAYER:
            self.max_layer += 1 if self.max_layer + 1 < TOP_LAYER else MAX_LAYER - self.max_layer
            self._since_s = self._raised_s = now
