"""All texts of one frame, and what of them lasts longer than a frame: the panel's figures, which
change twice a second, and notices."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

from pica_client.call.faces import FaceState
from pica_client.call.status import CallStatus
from pica_client.render.scene import Placement, Rect, head_rect_px, seat_rects_px
from pica_client.render.seats import MAX_FREE, FreeShares, ViewState, plan_camera, plan_seats
from pica_client.ui.avatar_presenter import AvatarPresenter, CallScene, Meter
from pica_client.ui.controls import ControlState
from pica_client.ui.hud import POOR_NOTE, banner_items, help_item, margin_px, name_items, own_items
from pica_client.ui.statistics_table import (
    TablePlace,
    draw_shares_ms,
    place_table,
    stacked_size_px,
    summary_item,
    table_item,
)
from pica_client.ui.text_raster import OverlayItem, item_rect_px, item_size_px

STATUS_PERIOD_S = 0.5
"""How often figures change: readable, and a text costs 2 ms to set."""
NOTICE_S = 4.0
"""How long a notice stands."""
RECENT_FRAMES = 60


class HudFrame:
    """Writes the texts of each frame.

    Args:
        meter: Durations of the call.
        status: How the call stands, at a time in seconds.

    Attributes:
        free: What the seats must keep free for the texts.
    """

    def __init__(self, meter: Meter, status: Callable[[float], CallStatus]) -> None:
        self.free = FreeShares()
        self._meter = meter
        self._ask_status = status
        self._status = CallStatus()
        self._asked_s: float | None = None
        self._statistics: list[OverlayItem] = []
        self._place: tuple[object, TablePlace] | None = None
        self._stacked = (0, 0)
        self._panel_px: Rect | None = None
        self._times: deque[float] = deque(maxlen=RECENT_FRAMES)
        self._notice: tuple[str, float] | None = None

    def notice(self, text: str, now: float) -> None:
        """Tell the user something for a few seconds."""
        self._notice = (text, now + NOTICE_S)

    def items(
        self,
        now: float,
        scene: CallScene,
        presenter: AvatarPresenter,
        state: ControlState,
        size: tuple[int, int],
        *,
        is_recording: bool,
    ) -> list[OverlayItem]:
        """What to draw over a scene."""
        self._times.append(now)
        is_due = self._asked_s is None or now - self._asked_s >= STATUS_PERIOD_S
        if is_due:
            self._asked_s = now
            self._status = self._ask_status(now)
        items = self.names(now, scene, presenter)
        help_panel = help_item(size, state.own_face) if state.show_help else None
        # Whoever reads the keys still wants to see everybody.
        right = 0.0 if help_panel is None else _share_at_right(help_panel, size)
        if not state.show_statistics:
            self._statistics, self.free = [], FreeShares(right=right)
        else:
            if is_due or not self._statistics:
                self._statistics = self._set_statistics(now, scene, presenter, size)
            items += self._placed(scene, state, size, right)
        if self._notice is not None and now >= self._notice[1]:
            self._notice = None
        notice = "" if self._notice is None else self._notice[0]
        taken = self._panel_px if state.show_statistics else None
        items += banner_items(self._status, state.own_face, notice, size, taken=taken)
        items += own_items(
            state.own_face, is_recording, size, is_connected=self._status.is_connected
        )
        return items if help_panel is None else [*items, help_panel]

    def names(self, now: float, scene: CallScene, presenter: AvatarPresenter) -> list[OverlayItem]:
        """The names of a scene, as its camera sees them; all else is the same for two eyes."""
        return name_items(
            scene.faces,
            scene.placements,
            scene.camera,
            presenter.problems,
            speaking=presenter.speaking(now),
            quality={peer_id: peer.quality for peer_id, peer in self._status.peers.items()},
        )

    def _set_statistics(
        self, now: float, scene: CallScene, presenter: AvatarPresenter, size: tuple[int, int]
    ) -> list[OverlayItem]:
        rects = {
            placement.slot: _on_picture(head_rect_px(scene.camera, placement.world_from_head), size)
            for placement in scene.placements
        }
        draw_ms = self._meter.recent_ms("draw")["p50"]
        shares = draw_shares_ms(rects, draw_ms)
        table = table_item(scene.faces, presenter.figures(now), self._status, shares, size)
        return [table, summary_item(self._summary(draw_ms), size)]

    def _summary(self, draw_ms: float | None) -> list[tuple[str, str]]:
        times = self._times
        span_s = times[-1] - times[0] if len(times) > 1 else 0.0
        lines = [(f"{(len(times) - 1) / span_s:.1f}" if span_s > 0 else "-", "fps")]
        if draw_ms is not None:
            lines.append(("draw", f"{draw_ms:.1f} ms"))
        latency_ms = self._meter.recent_ms("latency")["p95"]
        if latency_ms is not None and 0 <= latency_ms < 10_000:
            lines.append(("latency p95", f"{latency_ms:.0f} ms"))
        return [*lines, *self._status.summary]

    def _placed(
        self, scene: CallScene, state: ControlState, size: tuple[int, int], right: float
    ) -> list[OverlayItem]:
        """The statistics where no seat is, whatever the user does with the view."""
        names = tuple((face.peer_id, face.name) for face in scene.faces)
        key = (names, state.layout, state.pinned, size, right)
        stacked = stacked_size_px(self._statistics)
        is_same = self._place is not None and self._place[0] == key
        if is_same:  # a number that loses a digit moves nothing; one that gains one, once
            stacked = max(stacked[0], self._stacked[0]), max(stacked[1], self._stacked[1])
        if self._place is None or not is_same or stacked != self._stacked:
            self._stacked = stacked
            # Kept free even while nothing is recorded: a table that jumps away is a nuisance.
            badges = [item_rect_px(item, size) for item in own_items("sent", True, size)]
            if right:
                badges.append((size[0] * (1 - right), 0.0, float(size[0]), float(size[1])))
            taken = seat_rects(scene.faces, state, size, FreeShares(right=right))
            self._place = (key, place_table(stacked, taken, size, badges))
        place = self._place[1]
        self.free = FreeShares(top=place.free.top, right=right)
        self._panel_px = (
            place.x_px,
            place.y_px,
            place.x_px + stacked[0],
            place.y_px + stacked[1],
        )
        placed, y_px = [], place.y_px
        for item in self._statistics:
            placed.append(replace(item, x_px=place.x_px, y_px=y_px))
            y_px += item_size_px(item)[1]
        return placed


def seat_rects(
    faces: Sequence[FaceState],
    state: ControlState,
    size: tuple[int, int],
    free: FreeShares | None = None,
) -> list[Rect]:
    """Where heads and names are as long as nobody moves the view, with so much kept free."""
    peers = [face.peer_id for face in faces]
    plan = plan_seats(
        state.layout,
        len(peers),
        size[0] / size[1],
        pinned=peers.index(state.pinned) if state.pinned in peers else None,
        free=free,
    )
    camera = plan_camera(plan, ViewState(), *size)
    seated = [
        Placement(slot=peer, world_from_head=seat.astype("float32"))
        for peer, seat in zip(peers, plan.seats, strict=True)
    ]
    # With a line under each name: whoever is well to be seen now may not be so in a moment.
    notes = dict.fromkeys(peers, POOR_NOTE)
    names: Sequence[OverlayItem] = name_items(faces, seated, camera, notes)
    return [*seat_rects_px(plan, size), *(item_rect_px(item, size) for item in names)]


def _share_at_right(item: OverlayItem, size: tuple[int, int]) -> float:
    """The part of the picture from an item at its right edge on."""
    left = item_rect_px(item, size)[0] - 0.5 * margin_px(size)
    return min(max(1 - left / size[0], 0.0), MAX_FREE)


def _on_picture(rect: Rect | None, size: tuple[int, int]) -> Rect | None:
    """The part of a rectangle that is on the picture."""
    if rect is None:
        return None
    left, right = (min(max(x, 0.0), float(size[0])) for x in (rect[0], rect[2]))
    top, bottom = (min(max(y, 0.0), float(size[1])) for y in (rect[1], rect[3]))
    return left, top, right, bottom
