"""What every head gets in a frame: level, what to decode, share of its stream. Pure.

    scheduler = Scheduler()
    plan = scheduler.plan_view(heads, cameras, size_px, budget_s, now)
    for head, request in requests_of(heads, now): pool.submit(head.slot, request)
    ...
    scheduler.note_decoded(head, result, upload_s)       # what it cost
    placement = head.dressed(placement)                  # its resolution
    scheduler.costs.observe_draw(num_triangles, plan.shaded_px, draw_s)

Theory of operation. The taller a head is, the finer the level that it gets. A face that has changed
is decoded again. When a frame is expected to cost more than its budget (`cost_model`), first those
who only listen are drawn less often, then heads count as smaller, one after the other and the
lowest first, until it fits.
Those who have the coarsest level by then, and are still too much, are drawn in three quarters or
half of the resolution. What the tests hold it to:

- The budget is kept whenever the least of everybody fits, but for the one oldest head that is
  decoded in any case, so that no maps grow older than `MAX_AGE_S`, and for speakers while
  most listen.
- A nearer head never gets less than a farther one with the same past.
- The order of heads does not matter.
- Who cannot be seen costs nothing: no decode, no pixel, and after a while no stream.
- Levels do not flap: what has been reached is left only with a margin.

A knapsack over tables of errors leaves as much error at the same cost (measured:
docs/architecture.md).
"""

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pica_client.decode.request import DecodeRequest, DecodeResult
from pica_client.schedule.cost_model import CostModel
from pica_client.schedule.head import Choice, Decode, Head, see_heads
from pica_core.camera import Camera

DETAIL_PX = (80.0, 900.0)
"""Heights on the screen from which a head gets the next level: from the last one three pixels show
a triangle of the full mesh. Of the six avatars at 45 to 220 cm level 128 leaves an MSE of 1.6 to
5.1, level 64 one of 4 to 13; full maps on the mesh of level 128 would leave 0.1 to 0.6 less than
it, and take a quarter longer to decode and three times the upload (`pica bench scene`)."""
SHARE_PX = (12.0, 32.0)
"""Heads lower than the first get a quarter of their faces, than the second half; all others get
everything (chosen: 7.5 and 15 faces a second where a face is a dozen and a few dozen pixels
high)."""
LEAST_CHANGE = 0.05
"""Root mean square over the latent; what changed less is decoded when it is old."""
LEAST_TURN_RAD = 1e-3
"""A smaller turn of the view is the rounding of its direction."""
FACE_S = 1 / 30
"""Seconds between two faces of a stream."""
MAX_AGE_S = 0.25
"""Maps of a face that moves are not kept longer, whatever the budget; plus one frame."""
LISTENER_S = 1 / 8
"""How long a listener keeps a face while not everybody can be drawn at every face (chosen: nods and
smiles are still movements, and speech has the time that this leaves)."""
SMOOTHING = 0.05
"""What the newest gap counts in the average time between two frames (chosen: they come unevenly,
and what heads get must not change with each of them)."""
STREAM_HOLD_S = 1.0
"""How long the stream of a head that left the screen is still wanted."""
SCALES = (0.5, 0.75, 1.0)
"""Shares of the image's resolution that heads are drawn with. The last resort (processor time of
decoding and drawing, and MSE, measured on three heads at 120 cm: full maps 15.1 ms and 2.2; level
128 13.1 and 2.5, in three quarters 12.0 and 15.2, in half 10.0 and 29.8; level 64 10.6 and 7.1, in
three quarters 9.7 and 17.6, in half 8.2 and 31.5)."""
STEP = 1.1
"""How many times smaller a head counts when its turn comes."""
MOST_TURNS = 48
"""No head has more turns: it counts as a hundredth."""
RAISE_RATIO = 0.95
"""Detail comes back when it would leave the rest of the budget unspent."""
KEEP_RATIO = 0.85
"""A head keeps what it reached until it is so much lower than what it takes to reach it."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Plan:
    """What everybody gets in this frame."""

    choices: Mapping[str, Choice]
    """Choices keyed by the slot of their head."""
    cost_s: float
    """Seconds that decodes, uploads and drawing are expected to take."""
    is_short: bool
    """Whether listeners are to be drawn less often: everybody at every face would cost too much."""
    shaded_px: float
    """Pixels that the pixel decoder runs on, as far as one can tell without counting them."""


class Scheduler:
    """Plans frame after frame; see the module for how."""

    def __init__(self) -> None:
        self.costs = CostModel()
        self._turns = 0
        self._is_short = False
        self._since_s = FACE_S  # between two frames, on average
        self._now = -math.inf
        # Of this frame, by slot and shrink: one plan asks some eight times for each head.
        self._known: dict[tuple[str, float], tuple[int, float]] = {}

    def plan_view(
        self,
        heads: Sequence[Head],
        cameras: Sequence[Camera],
        size_px: tuple[int, int],
        budget_s: float,
        now: float,
    ) -> Plan:
        """See the heads through one camera, or both eyes' (`see_heads`), and plan the frame."""
        see_heads(heads, cameras, size_px)
        return self.plan(heads, budget_s, now)

    def plan(self, heads: Sequence[Head], budget_s: float, now: float) -> Plan:
        """Choose what everybody gets in the frame that begins now; each head is told.

        Args:
            heads: Everybody who has a face, in any order; slots are unique.
            budget_s: What decodes, uploads and drawing of this frame may take, seconds.
        """
        since_s, self._now = min(now - self._now, LISTENER_S), now
        self._since_s += SMOOTHING * (since_s - self._since_s)
        self._known.clear()
        seen = sorted((head for head in heads if head.sight.is_visible), key=_lowest_first)
        shrinks = self._fit(seen, budget_s)
        spent_s = self._draw_s(seen, shrinks)
        has_decoded, shaded_px = False, 0.0
        num_speaking = sum(not head.is_listening for head in seen)
        are_few = 2 * num_speaking <= len(seen)
        for head, shrink in sorted(zip(seen, shrinks, strict=True), key=_oldest_first):
            head.seen_s = now
            levels, (level, scale) = head.avatar.levels, self._gets(head, shrink)
            decode = _wanted(head, levels[level], now)
            if decode != "none":
                # One is decoded in any case, so that not everybody is overdue at once, and the
                # few who speak, whom all look at.
                asked_s = head.latent_asked_s if decode == "both" else head.asked_s
                is_needed = now - asked_s >= MAX_AGE_S or not has_decoded
                is_needed |= are_few and not head.is_listening
                held = level if head.held_level is None else levels.index(head.held_level)
                decode_s = self.costs.decode_s(head.model, levels[level], decode)
                if is_needed or held > level or spent_s + decode_s <= budget_s:
                    spent_s += decode_s
                    has_decoded = True
                else:
                    decode, level = "none", held
            shaded_px += scale**2 * head.sight.visible_px
            head.choice = Choice(
                level=levels[level],
                decode=decode,
                scale=scale,
                every=self._every(head),
            )
        for head in heads:
            if not head.sight.is_visible:
                head.choice = _unseen(head, now)
        return Plan(
            choices={head.slot: head.choice for head in heads if head.choice is not None},
            cost_s=spent_s,
            is_short=self._is_short,
            shaded_px=shaded_px,
        )

    def note_decoded(self, head: Head, result: DecodeResult, upload_s: float) -> None:
        """Learn what a decode and its upload cost."""
        took_s = result.decode_s + upload_s
        self.costs.observe_decode(head.model, result.level, result.parts, took_s)

    def _fit(self, seen: Sequence[Head], budget_s: float) -> list[float]:
        """How many times smaller each head must count, the lowest first."""

        def cost_s(turns: int) -> float:
            shrinks = _shrinks(len(seen), turns)
            decodes_s = 0.0
            for head, shrink in zip(seen, shrinks, strict=True):
                level = head.avatar.levels[self._gets(head, shrink)[0]]
                decodes_s += self._share(head) * self.costs.decode_s(head.model, level, "both")
            return self._draw_s(seen, shrinks) + decodes_s

        was_short, self._is_short = self._is_short, False
        self._is_short = cost_s(0) > budget_s * (RAISE_RATIO if was_short else 1.0)
        most = len(seen) * MOST_TURNS
        self._turns = min(self._turns, most)
        while self._turns > 0 and cost_s(self._turns - 1) < RAISE_RATIO * budget_s:
            self._turns -= 1
        while self._turns < most and cost_s(self._turns) > budget_s:
            self._turns += 1
        return _shrinks(len(seen), self._turns)

    def _share(self, head: Head) -> float:
        """The share of images in which a head is drawn: the others keep what was drawn."""
        is_resting = self._is_short and head.is_listening
        return min(self._since_s / (LISTENER_S if is_resting else FACE_S), 1.0)

    def _every(self, head: Head) -> int:
        """Which frames of its stream are wanted: of a listener who is not drawn at every face half
        are more than are drawn."""
        every = (4, 2, 1)[bisect_right(SHARE_PX, head.sight.head_px)]
        return max(every, 2) if self._is_short and head.is_listening else every

    def _gets(self, head: Head, shrink: float) -> tuple[int, float]:
        """Which of the avatar's levels it gets in this frame, and its share of the resolution."""
        key = head.slot, shrink
        if key not in self._known:
            self._known[key] = _find_place(head, shrink), _find_scale(head, shrink)
        return self._known[key]

    def _draw_s(self, seen: Sequence[Head], shrinks: Sequence[float]) -> float:
        """Seconds an image, on average, that drawing heads takes."""
        draw, total_s = self.costs.draw, self.costs.draw.frame_s if seen else 0.0
        for head, shrink in zip(seen, shrinks, strict=True):
            place, scale = self._gets(head, shrink)
            triangles = head.sight.num_views * head.num_triangles[place]
            pixels = scale**2 * head.sight.visible_px
            total_s += self._share(head) * (draw.pixel_s * pixels + draw.triangle_s * triangles)
        return total_s


def requests_of(heads: Sequence[Head], now: float) -> list[tuple[Head, DecodeRequest]]:
    """What to decode for the planned frame, near heads first; they count as asked for."""
    nearest = sorted(heads, key=lambda head: -head.sight.head_px)
    return [(head, asked) for head in nearest if (asked := head.request(now)) is not None]


def _find_place(head: Head, shrink: float) -> int:
    levels = head.avatar.levels
    held = 0 if head.held_level is None else levels.index(head.held_level)
    height = head.sight.head_px / shrink
    reached = (
        height >= least_px * (KEEP_RATIO if number < held else 1.0)
        for number, least_px in enumerate(DETAIL_PX)
    )
    return min(sum(reached), len(levels) - 1)


def _find_scale(head: Head, shrink: float) -> float:
    """The share of the image's resolution that a head is drawn with: less than the whole where it
    must count as smaller than what gets the coarsest level."""
    before = 1.0 if head.choice is None else head.choice.scale
    height = max(head.sight.head_px, 1e-3)
    excess = max(shrink * min(height, DETAIL_PX[0]) / height, 1.0)
    return min(
        scale for scale in SCALES if scale * excess >= (KEEP_RATIO if scale >= before else 1.0)
    )


def _wanted(head: Head, level: int, now: float) -> Decode:
    """What to decode at a level."""
    if head.held_level != level:
        return "both"
    # Turning asks for expression maps again and again: they do not make the latent newer.
    is_old = now - head.latent_asked_s >= MAX_AGE_S / 2
    if head.latent_change > (0.0 if is_old else LEAST_CHANGE):
        return "both"
    return "expression" if head.view_turn_rad > LEAST_TURN_RAD else "none"


def _unseen(head: Head, now: float) -> Choice:
    if head.seen_s is None:
        head.seen_s = now
    is_wanted = now - head.seen_s < STREAM_HOLD_S
    level = head.held_level or head.avatar.levels[0]
    return Choice(level, "none", 1.0, int(is_wanted))


def _shrinks(num_heads: int, turns: int) -> list[float]:
    """How many times smaller heads count after so many turns, the lowest first.

    Heads of one height would all lose a level in the same frame if they had no turns.
    """
    return [STEP ** ((turns + num_heads - 1 - rank) // num_heads) for rank in range(num_heads)]


def _lowest_first(head: Head) -> tuple[float, str]:
    # What a head has counts as height: two who sway side by side must not change places.
    held = 0 if head.choice is None else head.avatar.levels.index(head.choice.level)
    return head.sight.head_px * STEP**held, head.slot


def _oldest_first(turn: tuple[Head, float]) -> tuple[float, float, str]:
    head, _ = turn
    return head.asked_s, -head.sight.head_px, head.slot
