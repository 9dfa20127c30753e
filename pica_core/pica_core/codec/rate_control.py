"""Keep a latent stream at a bitrate, by choosing each frame's quality. Pure: `now_s` is an
argument.

A bucket fills with bits at the target rate and holds half a second's worth; frames take theirs out
of it. A frame may take a share of what is there, a base frame the largest, since others build on
it: so a face that begins to move spends what a quiet one saved, and grows coarser smoothly as the
bucket empties. A frame that is too large is coded anew one quality coarser. Of frames that are too
large at the coarsest quality, upper layers are left out, base frames are sent all the same and the
bucket is in debt. Quality rises by one a base frame at most: a face that grows finer is a change
that is seen.

So over any second no more than 1.5 times the target is sent, keyframes on request and base frames
at the coarsest quality aside.
"""

CAPACITY_S = 0.5
"""What the bucket holds, in seconds of the target rate (chosen: a word)."""
SHARES = (0.5, 0.35, 0.25)
"""Part of the bucket's content that a frame may take, by layer."""


class RateController:
    """Chooses qualities.

    Args:
        target_bps: Payload bits a second to keep to.
        num_qualities: How many there are; the last is the finest.
        start: Quality to begin with.

    Attributes:
        quality: That of the last frame: where the next one of an upper layer begins.
    """

    def __init__(self, target_bps: float, num_qualities: int, start: int) -> None:
        self._target_bps = target_bps
        self._highest = num_qualities - 1
        self.quality = start
        self._bits = target_bps * CAPACITY_S
        self._filled_s: float | None = None

    def propose(self, layer: int) -> int:
        """The finest quality that a frame of a layer may have."""
        return min(self.quality + (layer == 0), self._highest)

    def has_room(self, num_bytes: int, layer: int, now_s: float) -> bool:
        """Whether a frame of this size is within its share."""
        self._fill(now_s)
        return 8 * num_bytes <= SHARES[layer] * self._bits

    def sent(self, num_bytes: int, quality: int, now_s: float) -> None:
        """Take a frame out of the bucket; it may owe as much as it holds."""
        self._fill(now_s)
        self.quality = quality
        self._bits = max(self._bits - 8 * num_bytes, -self._target_bps * CAPACITY_S)

    def _fill(self, now_s: float) -> None:
        if self._filled_s is not None:
            gained = max(now_s - self._filled_s, 0.0) * self._target_bps
            self._bits = min(self._bits + gained, self._target_bps * CAPACITY_S)
        self._filled_s = now_s
