"""What every head gets in a frame: level, what to decode, mesh, share of its stream. Pure.

Theory of operation. The taller a head is, the more it gets: the coarsest level, the middle one, the
full maps on the middle mesh, and on their own. A face that has changed is decoded again, and drawn,
when its maps are old enough: at once unless the head is tiny. When a frame is expected to cost more
than its budget (`cost_model`), first those who only listen are drawn less often, then heads count
as smaller, one after the other and the lowest first, until it fits: by a quarter or a half, they
are drawn so much smaller, and enlarged. What the tests hold it to:

- The budget is kept whenever the least of everybody fits, but for the one oldest head that is
  decoded in any case, so that no maps grow older than `max_age_s`.
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

from pica_client.errors import OptionError, check_ranges
from pica_client.schedule.cost_model import CostModel
from pica_client.schedule.head import Choice, Decode, Head

FACE_S = 1 / 30
"""Seconds between two faces of a stream."""
STEP = 1.1
"""How many times smaller a head counts when its turn comes."""
MOST_TURNS = 48
"""No head has more turns: it counts as a hundredth."""
RAISE_RATIO = 0.95
"""Detail comes back when it would leave the rest of the budget unspent."""
KEEP_RATIO = 0.85
"""A head keeps what it reached until it is so much lower than what it takes to reach it."""
SCALES = (0.5, 0.75, 1.0)
"""Shares of the image's resolution that heads are drawn with (measured on three heads at 65, 90 and
120 cm: three quarters save 34, 26 and 23 % of the processor time, half of it 50 to 60)."""
LEAST_TURN_RAD = 1e-3
"""A smaller turn of the view is the rounding of its direction."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SchedulerOptions:
    """Heights on the screen at which a head gets more, pixels, and times."""

    full_px: float = 80.0
    """Height from which a head gets more than the coarsest level: the next to full one, or full
    maps on the coarsest mesh if there is none (all thresholds are tuned on one avatar at 50
    and 130 cm)."""
    mesh_px: tuple[float, ...] = (250.0, 900.0)
    """Heights from which it gets full maps on the next finer mesh, on the full one at last: there,
    three pixels show a triangle (measured with five at 65 cm: 36 % of the triangles, 79 % of the
    processor time of an image, at an error of 7.6 in place of 4.2)."""
    refresh_px: float = 20.0
    """Height from which every face is decoded; of heads half as high every second one."""
    least_change: float = 0.05
    """Root mean square over the latent; what changed less is decoded when it is old."""
    max_age_s: float = 0.25
    """Maps of a face that moves are not kept longer, whatever the budget; plus one frame."""
    listener_s: float = 1 / 8
    """How long a listener keeps a face while not everybody can be drawn at every face (chosen: nods
    and smiles are still movements, and speech has the time that this leaves)."""
    stream_hold_s: float = 1.0
    """How long the stream of a head that left the screen is still wanted."""
    share_px: tuple[float, float] = (12.0, 32.0)
    """Heads lower than the first get a quarter of their faces, than the second half; all others get
    everything (chosen: 7.5 and 15 faces a second where a face is a dozen and a few dozen pixels
    high)."""

    def __post_init__(self) -> None:
        check_ranges(self, full_px=(0, 1e4), refresh_px=(0, 1e4), least_change=(0, 10))
        check_ranges(self, max_age_s=(0.001, 60), stream_hold_s=(0, 600), listener_s=(0.01, 1))
        for name, most in (("mesh_px", 8), ("share_px", 2)):
            values = getattr(self, name)
            if list(values) != sorted(values) or len(values) > most:
                raise OptionError(f"{name} is {values}; ascending, at most {most}")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Plan:
    """What everybody gets in this frame."""

    choices: Mapping[str, Choice]
    """Choices keyed by the slot of their head."""
    cost_s: float
    """Seconds that decodes, uploads and drawing are expected to take."""
    floor_s: float
    """Seconds that the least for everybody takes; above the budget it is all there is."""
    is_short: bool
    """Whether listeners are to be drawn less often: everybody at every face would cost too much."""
    shaded_px: float
    """Pixels that the pixel decoder runs on, as far as one can tell without counting them."""


class Scheduler:
    """Plans frame after frame; see the module for how."""

    def __init__(self, options: SchedulerOptions | None = None) -> None:
        self.options = options or SchedulerOptions()
        self.costs = CostModel()
        self._turns = 0
        self._is_short = False
        self._since_s = 0.0
        self._now = -math.inf
        # Of this frame, by slot and shrink: one plan asks some eight times for each head.
        self._known_places: dict[tuple[str, float], tuple[int, int]] = {}

    def plan(self, heads: Sequence[Head], budget_s: float, now: float) -> Plan:
        """Choose what everybody gets in the frame that begins now; each head is told.

        Args:
            heads: Everybody in the call, in any order; slots are unique.
            budget_s: What decodes, uploads and drawing of this frame may take, seconds.
        """
        self._since_s, self._now = min(now - self._now, self.options.listener_s), now
        self._known_places.clear()
        seen = sorted((head for head in heads if head.sight.is_visible), key=_lowest_first)
        shrinks = self._fit(seen, budget_s)
        spent_s = self._draw_s(seen, shrinks)
        floor_s = self._draw_s(seen, _shrinks(len(seen), len(seen) * MOST_TURNS))
        has_decoded, shaded_px = False, 0.0
        for head, shrink in sorted(zip(seen, shrinks, strict=True), key=_oldest_first):
            head.seen_s = now
            decode, level, mesh = self._wanted(head, shrink, now)
            decode_s = self._decode_s(head, level, decode)
            # One is decoded in any case, so that not everybody is overdue at once.
            asked_s = head.latent_asked_s if decode == "both" else head.asked_s
            is_needed = now - asked_s >= self.options.max_age_s
            kept = _kept(head, level, mesh)
            can_wait = decode != "none" and has_decoded and not is_needed and kept[1] <= mesh
            is_kept_back = can_wait and spent_s + decode_s > budget_s
            if is_kept_back:
                scale = self._scale(head, shrink)
                spent_s += self._head_s(head, kept[1], scale) - self._head_s(head, mesh, scale)
                decode, decode_s, (level, mesh) = "none", 0.0, kept
            if decode != "none" and (is_needed or not has_decoded):
                floor_s += self._decode_s(head, 0, "both")
            has_decoded = has_decoded or decode != "none"
            spent_s += decode_s
            levels, scale = head.avatar.levels, self._scale(head, shrink)
            shaded_px += scale**2 * head.sight.visible_px
            head.choice = Choice(
                level=levels[level],
                decode=decode,
                mesh_level=levels[mesh],
                scale=scale,
                every=self._every(head),
                cost_s=decode_s + self._head_s(head, mesh, scale),
                is_limited=is_kept_back or scale < 1 or (level, mesh) != self._places(head, 1.0),
            )
        for head in heads:
            if not head.sight.is_visible:
                head.choice = self._unseen(head, now)
        return Plan(
            choices={head.slot: head.choice for head in heads if head.choice is not None},
            cost_s=spent_s,
            floor_s=floor_s,
            is_short=self._is_short,
            shaded_px=shaded_px,
        )

    def level(self, head: Head) -> int:
        """The level of the maps that a head gets while there is time."""
        return head.avatar.levels[self._find_places(head, 1.0)[0]]

    def _fit(self, seen: Sequence[Head], budget_s: float) -> list[float]:
        """How many times smaller each head must count, the lowest first."""

        def cost_s(turns: int) -> float:
            shrinks = _shrinks(len(seen), turns)
            return self._draw_s(seen, shrinks) + sum(
                self._decode_s(head, self._places(head, shrink)[0], "both")
                * min(self._share(head), self._since_s / self._interval_s(head, shrink), 1.0)
                for head, shrink in zip(seen, shrinks, strict=True)
            )

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
        return min(self._since_s / (self.options.listener_s if is_resting else FACE_S), 1.0)

    def _places(self, head: Head, shrink: float) -> tuple[int, int]:
        """Places, among the avatar's levels, of the maps and of the mesh in this frame."""
        key = head.slot, shrink
        if key not in self._known_places:
            self._known_places[key] = self._find_places(head, shrink)
        return self._known_places[key]

    def _find_places(self, head: Head, shrink: float) -> tuple[int, int]:
        levels, options = head.avatar.levels, self.options
        top = len(levels) - 1
        height = head.sight.head_px / shrink

        def is_reached(threshold_px: float, was_reached: bool) -> bool:
            return height >= threshold_px * (KEEP_RATIO if was_reached else 1.0)

        held = 0 if head.held_level is None else levels.index(head.held_level)
        if not is_reached(options.full_px, held > 0):
            return 0, 0
        before = levels.index(head.choice.mesh_level) if head.choice and held == top else -1
        coarsest = top - len(options.mesh_px)
        finer = sum(
            is_reached(threshold_px, before > coarsest + number)
            for number, threshold_px in enumerate(options.mesh_px)
        )
        if finer == 0 and top > 1:
            # Full maps on the coarsest mesh cost more, and leave twice the error.
            return top - 1, top - 1
        return top, max(coarsest + finer, 0)

    def _scale(self, head: Head, shrink: float) -> float:
        """The share of the image's resolution that a head is drawn with."""
        before = 1.0 if head.choice is None else head.choice.scale
        return min(
            scale for scale in SCALES if scale * shrink >= (KEEP_RATIO if scale >= before else 1.0)
        )

    def _interval_s(self, head: Head, shrink: float) -> float:
        """Seconds between two decodes; at most half of what is too old, to be spread over it."""
        faces = self.options.refresh_px / max(head.sight.head_px / shrink, 1e-3)
        return min(FACE_S * faces, self.options.max_age_s / 2)

    def _wanted(self, head: Head, shrink: float, now: float) -> tuple[Decode, int, int]:
        """What to decode, and the places of the maps and the mesh that are drawn then."""
        options = self.options
        level, mesh = self._places(head, shrink)
        if head.held_level != head.avatar.levels[level]:
            return "both", level, mesh
        age_s = now - head.asked_s
        interval_s = self._interval_s(head, shrink)
        # The first display frame after the interval, however frames fall.
        if interval_s > FACE_S and age_s < interval_s - FACE_S / 4:
            return "none", level, mesh
        # Turning asks for expression maps again and again: they do not make the latent newer.
        is_old = now - head.latent_asked_s >= options.max_age_s / 2
        if head.latent_change > (0.0 if is_old else options.least_change):
            return "both", level, mesh
        is_turned = head.view_turn_rad > LEAST_TURN_RAD
        return "expression" if is_turned else "none", level, mesh

    def _decode_s(self, head: Head, level: int, decode: Decode) -> float:
        if decode == "none":
            return 0.0
        return self.costs.decode_s(head.model, head.avatar.levels[level], decode)

    def _head_s(self, head: Head, mesh: int, scale: float) -> float:
        """Seconds an image, on average, that drawing a head takes."""
        draw, sight = self.costs.draw, head.sight
        triangles = sight.num_views * head.num_triangles[mesh]
        drawn_s = draw.pixel_s * scale**2 * sight.visible_px + draw.triangle_s * triangles
        return self._share(head) * drawn_s

    def _draw_s(self, seen: Sequence[Head], shrinks: Sequence[float]) -> float:
        return (self.costs.draw.frame_s if seen else 0.0) + sum(
            self._head_s(head, self._places(head, shrink)[1], self._scale(head, shrink))
            for head, shrink in zip(seen, shrinks, strict=True)
        )

    def _unseen(self, head: Head, now: float) -> Choice:
        if head.seen_s is None:
            head.seen_s = now
        is_wanted = now - head.seen_s < self.options.stream_hold_s
        level = head.held_level or head.avatar.levels[0]
        return Choice(level, "none", level, 1.0, int(is_wanted), 0.0, False)

    def _every(self, head: Head) -> int:
        sight = head.sight
        height = sight.head_px * math.sqrt(max(1 - sight.hidden_ratio, 0.0))
        return (4, 2, 1)[bisect_right(self.options.share_px, height)]


def _kept(head: Head, level: int, mesh: int) -> tuple[int, int]:
    """Places of what is drawn when the maps are kept; the full ones may have any mesh."""
    if head.held_level is None:
        return level, mesh
    held = head.avatar.levels.index(head.held_level)
    is_full = held == len(head.avatar.levels) - 1
    return held, min(mesh, held) if is_full else held


def _shrinks(num_heads: int, turns: int) -> list[float]:
    """How many times smaller heads count after so many turns, the lowest first.

    Heads of one height would all lose a level in the same frame if they had no turns.
    """
    return [STEP ** ((turns + num_heads - 1 - rank) // num_heads) for rank in range(num_heads)]


def _lowest_first(head: Head) -> tuple[float, str]:
    # What a head has counts as height: two who sway side by side must not change places.
    held = 0 if head.choice is None else head.avatar.levels.index(head.choice.mesh_level)
    return head.sight.head_px * STEP**held, head.slot


def _oldest_first(turn: tuple[Head, float]) -> tuple[float, float, str]:
    head, _ = turn
    return head.asked_s, -head.sight.head_px, head.slot
