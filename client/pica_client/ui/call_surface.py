"""The surface of a call: what there is to show is collected into a `CallView`, panels draw it.

Keeps what lasts longer than a frame: the figures, which change twice a second, notices, and
whether the control bar is to be seen.
"""

from collections import deque
from collections.abc import Callable

import moderngl

from pica_client.call.participants import notices
from pica_client.call.status import CallStatus, PeerStatus
from pica_client.render.labels import place_labels
from pica_client.render.scene import common_px, head_rect_px
from pica_client.render.seats import MAX_FREE, FreeShares
from pica_client.ui.actions import Request
from pica_client.ui.avatar_presenter import AvatarPresenter, CallScene, Meter
from pica_client.ui.call_view import NOTHING, CallView, OwnFaceView, Panel, PersonView
from pica_client.ui.events import InputEvent, MouseMoved, MousePressed
from pica_client.ui.notice_board import Notice, NoticeBoard
from pica_client.ui.panels.control_bar import bar_share, control_bar, leave_question
from pica_client.ui.panels.names import least_name_px, names
from pica_client.ui.panels.participants import participants_panel
from pica_client.ui.panels.self_view import self_view, self_view_px
from pica_client.ui.panels.settings import settings_panel
from pica_client.ui.panels.side import help_panel, side_share
from pica_client.ui.panels.signs import signs
from pica_client.ui.panels.statistics import statistics
from pica_client.ui.panels.upper_edge import signs_share, statistics_share
from pica_client.ui.panels.waiting import first_hint, hint_share, waiting_page
from pica_client.ui.state import ViewState
from pica_client.ui.surface.painter import Painter
from pica_client.ui.surface.surface import Surface
from pica_client.voice.sound.settings import SoundState

PANELS: tuple[Panel, ...] = (
    names,
    signs,
    self_view,
    statistics,
    waiting_page,
    participants_panel,
    settings_panel,
    help_panel,
    first_hint,
    control_bar,
    leave_question,
)
"""All panels, in the order in which they are drawn."""
STATUS_PERIOD_S = 0.5
"""How often figures change: readable."""
BAR_S = 4.0
"""How long the control bar stays after the pointer has moved (chosen: as video players do)."""
RECENT_FRAMES = 60
Clipboard = tuple[Callable[[], str], Callable[[str], None]]


class CallSurface:
    """Draws the surface of a call.

    Args:
        status: How the call stands, at a time in seconds.
        has_pointer: Whether there is somebody to steer: a window.
        clipboard: Reads the system's, and writes it; None: the surface has one of its own.

    Attributes:
        free: What the seats must keep free.
        painter: Paints what `build` has set.
        status: How the call stands, as of the last frame.
    """

    def __init__(
        self,
        context: moderngl.Context,
        size: tuple[int, int],
        meter: Meter,
        status: Callable[[float], CallStatus],
        *,
        has_pointer: bool,
        clipboard: Clipboard | None = None,
    ) -> None:
        self.free = FreeShares()
        self._surface = Surface(size)
        if clipboard is not None:
            self._surface.use_clipboard(*clipboard)
        self.painter = Painter(context, self._surface)
        self._meter = meter
        self._ask_status = status
        self.status = CallStatus()
        self._asked_s: float | None = None
        self._draw_ms: float | None = None
        self._figures: tuple[tuple[str, str], ...] = ()
        self._has_pointer = has_pointer
        self._pointer_s: float | None = None
        self._times: deque[float] = deque(maxlen=RECENT_FRAMES)
        self._board = NoticeBoard()

    def close(self) -> None:
        """Free what ImGui holds."""
        self._surface.close()

    def notice(self, text: str, now: float) -> None:
        """Tell the user something for a few seconds."""
        self._board.add(Notice(text, "accent"), now)

    def begin(
        self,
        now: float,
        size: tuple[int, int],
        content_scale: float,
        events: list[InputEvent],
        state: ViewState,
    ) -> list[InputEvent]:
        """Begin a frame of this size; gives the events that are not for the surface.

        Args:
            content_scale: Pixels a point of the display.
        """
        self._surface.resize(size, content_scale * state.scale, state.mode)
        for event in events:
            self._surface.receive(event)
            if isinstance(event, MouseMoved | MousePressed):
                self._has_pointer, self._pointer_s = True, now
        if self._pointer_s is None:
            self._pointer_s = now  # whoever enters is shown once how to leave
        self._surface.begin(now)
        return [event for event in events if not self._surface.claims(event)]

    @property
    def self_view_px(self) -> int:
        """How high the picture of one's own face is; 0 where there is no room for it."""
        return self_view_px(self._surface.metrics)

    def abandon(self) -> None:
        """End a frame of which nothing will be shown."""
        self._surface.end()

    def build(
        self,
        now: float,
        scene: CallScene,
        presenter: AvatarPresenter,
        state: ViewState,
        *,
        own: OwnFaceView = NOTHING,
        sound: SoundState | None = None,
    ) -> list[Request]:
        """Set the panels, and end the frame; gives what the user ordered."""
        self._times.append(now)
        if self._asked_s is None or now - self._asked_s >= STATUS_PERIOD_S:
            self._asked_s = now
            self.status = self._ask_status(now)
            for text, tone in notices(self.status.news):
                self._board.add(Notice(text, tone), now)
            self._draw_ms = self._meter.recent_ms("draw")["p50"]
            self._figures = self._figures_now()
        metrics = self._surface.metrics
        view = CallView(
            now=now,
            people=self._people(now, scene, presenter, state),
            status=self.status,
            notices=self._board.shown(now),
            shows_bar=self._shows_bar(now, state),
            has_pointer=self._has_pointer,
            own=own,
            sound=sound,
            figures=self._figures,
        )
        bar = bar_share(metrics) if self._has_pointer else 0.0
        self.free = FreeShares(
            top=min(
                max(statistics_share(state, view, metrics), signs_share(state, view, metrics)),
                MAX_FREE,
            ),
            right=min(side_share(state, metrics), MAX_FREE),
            bottom=min(bar + hint_share(state, metrics), MAX_FREE),
        )
        requests = [each for panel in PANELS for each in panel(state, view, metrics)]
        self._surface.end()
        return requests

    def _shows_bar(self, now: float, state: ViewState) -> bool:
        if not self._has_pointer:
            return False
        is_recent = self._pointer_s is not None and now - self._pointer_s < BAR_S
        return is_recent or state.side != "none" or self._surface.wants_mouse

    def _people(
        self, now: float, scene: CallScene, presenter: AvatarPresenter, state: ViewState
    ) -> tuple[PersonView, ...]:
        shares = self._draw_shares_ms(scene) if state.show_statistics else {}
        figures, problems = presenter.figures(now), presenter.problems
        people = []
        muted = {each.peer_id for each in self.status.participants if each.is_voice_muted}
        heads = [placement.world_from_head for placement in scene.placements]
        labels = place_labels(heads, scene.camera, least_name_px(self._surface.metrics))
        for face, label_px in zip(scene.faces, labels, strict=True):
            peer_id, found = face.peer_id, figures.get(face.peer_id)
            stream = self.status.peers.get(peer_id, PeerStatus())
            people.append(
                PersonView(
                    peer_id=peer_id,
                    name=face.name,
                    status=face.status,
                    note=problems.get(peer_id) or face.note,
                    is_speaking=found is not None and found.is_speaking,
                    is_voice_muted=peer_id in muted,
                    label_px=label_px,
                    figures=found,
                    stream=stream,
                    draw_ms=shares.get(peer_id),
                )
            )
        return tuple(people)

    def _draw_shares_ms(self, scene: CallScene) -> dict[str, float]:
        """The drawing time dealt out by the pixels that each head may cover: most of it is spent
        per pixel. An estimate; the GPU is not asked head by head."""
        picture = (0.0, 0.0, scene.camera.width, scene.camera.height)
        areas = {}
        for placement in scene.placements:
            rect = head_rect_px(scene.camera, placement.world_from_head)
            areas[placement.slot] = common_px(rect, picture) if rect else 0.0
        total = sum(areas.values())
        if self._draw_ms is None or total <= 0:
            return {}
        return {peer_id: self._draw_ms * area / total for peer_id, area in areas.items()}

    def _figures_now(self) -> tuple[tuple[str, str], ...]:
        times = self._times
        span_s = times[-1] - times[0] if len(times) > 1 else 0.0
        found = [(f"{(len(times) - 1) / span_s:.1f}" if span_s > 0 else "–", "fps")]
        if self._draw_ms is not None:
            found.append(("draw", f"{self._draw_ms:.1f} ms"))
        latency_ms = self._meter.recent_ms("latency")["p95"]
        if latency_ms is not None and 0 <= latency_ms < 10_000:
            found.append(("latency p95", f"{latency_ms:.0f} ms"))
        return (*found, *self.status.summary)
