"""Which layers of which streams the relay is told that we want, and when. Pure.

    wish(stream, layer, now)             what is wanted from now on; None is nothing at all
    due(now)                             what to tell the relay
    next_timer()                         when there may be more
    note_untold(stream, now)             it could not be told
    begin(now)                           a new connection: the relay sends everything again

Up at once, down late: a wish for more is told as soon as it is known, one for less when nothing
more has been wished for some time. So a head that comes and goes at the edge of the screen costs a
message or two a second at most, and its stream is there whenever it is seen.

A wish for *some* after none is told as a *resumption*: the relay then sends what it kept of the
stream, to be shown at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from pica_client.errors import OptionError
from pica_protocol.limits import MAX_LAYER

_NOTHING = -1
"""As a layer: below all."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LayerSubscriptionConfig:
    """How patient wishes are."""

    lower_after_s: float = 0.5
    """A wish for less is told when nothing more was wished for so long (chosen: longer than a
    glance aside)."""
    lower_interval_s: float = 1.0
    """Between two wishes for less of one stream."""

    def __post_init__(self) -> None:
        for name in ("lower_after_s", "lower_interval_s"):
            if not 0 <= getattr(self, name) <= 60:
                raise OptionError(f"{name} is {getattr(self, name)}; 0 to 60 is allowed")


class LayerSubscription(NamedTuple):
    """Something to tell the relay."""

    stream: int
    layer: int | None
    is_resumption: bool
    """Whether nothing came of the stream before."""


@dataclass(slots=True, eq=False)
class _Stream:
    told: int = MAX_LAYER
    """What the relay sends: everything, until it is told otherwise."""
    former: int = MAX_LAYER
    """What it sent before."""
    wished: int = MAX_LAYER
    lower_s: float = math.inf
    """When less is told; infinite while no less is wished."""
    highest: int = _NOTHING
    """Most that was wished since then."""
    lowered_s: float = -math.inf


class LayerSubscriptions:
    """The wishes for all streams of a call; unknown streams begin as the relay does, with all."""

    def __init__(self, config: LayerSubscriptionConfig | None = None) -> None:
        self.config = config or LayerSubscriptionConfig()
        self._streams: dict[int, _Stream] = {}  # bounded by its owner, who forgets streams

    def wish(self, stream: int, layer: int | None, now: float) -> bool:
        """Note what is wanted of a stream.

        Args:
            stream: Which.
            layer: Highest layer; None is nothing at all.
            now: The time.

        Returns:
            Whether `due` or `next_timer` may say something new.
        """
        wanted = _NOTHING if layer is None else min(layer, MAX_LAYER)
        entry = self._streams.get(stream)
        if entry is None:
            entry = self._streams[stream] = _Stream()
        if wanted == entry.wished:
            return False
        entry.wished = wanted
        if wanted >= entry.told:
            entry.lower_s = math.inf
        elif entry.lower_s < math.inf:
            entry.highest = max(entry.highest, wanted)
        else:
            self._lower(entry, now)
        return True

    def due(self, now: float) -> list[LayerSubscription]:
        """Take what the relay is to be told by now."""
        told = []
        for stream, entry in self._streams.items():
            if entry.wished > entry.told:
                layer = entry.wished
            elif now >= entry.lower_s:
                layer, entry.lowered_s, entry.lower_s = entry.highest, now, math.inf
                if entry.wished < layer:
                    self._lower(entry, now)
            else:
                continue
            entry.former, entry.told = entry.told, layer
            is_resumption = entry.former == _NOTHING
            told.append(
                LayerSubscription(stream, None if layer == _NOTHING else layer, is_resumption)
            )
        return told

    def _lower(self, entry: _Stream, now: float) -> None:
        """Begin to wait until less may be told."""
        config = self.config
        entry.highest = entry.wished
        entry.lower_s = max(now + config.lower_after_s, entry.lowered_s + config.lower_interval_s)

    def next_timer(self) -> float | None:
        """When a wish for less may be told; one for more is due at once."""
        timers = [entry.lower_s for entry in self._streams.values() if entry.lower_s < math.inf]
        return min(timers, default=None)

    def note_untold(self, stream: int, now: float) -> None:
        """Note that what was last due of a stream could not be told; it is due again."""
        entry = self._streams.get(stream)
        if entry is not None:
            entry.told = entry.former
            if entry.wished < entry.told:
                self._lower(entry, now)

    def wants(self, stream: int) -> bool:
        """Whether the relay sends anything of a stream, as far as it was told."""
        entry = self._streams.get(stream)
        return entry is None or entry.told != _NOTHING

    def forget(self, stream: int) -> None:
        """Forget a stream that has ended."""
        self._streams.pop(stream, None)

    def begin(self, now: float) -> None:
        """Begin a connection: the relay knows of no wish, so those for less are due now."""
        for entry in self._streams.values():
            entry.told = entry.former = MAX_LAYER
            if entry.wished < MAX_LAYER:
                entry.highest, entry.lower_s = entry.wished, now
            else:
                entry.lower_s = math.inf
