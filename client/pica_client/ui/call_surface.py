"""The surface of a call: what there is to show is collected into a `CallView`, panels draw it.

Keeps what lasts longer than a frame: how the call stands, twice a second, and notices.

A name stands on the chest of its owner, no wider than the shoulders and never over a face, neither
the owner's nor another's. A participant who cannot be seen has no name on the picture.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from pica_client.call.status import CallStatus, notices
from pica_client.render.scene import NEAR_M, Rect, common_px
from pica_client.render.seats import FreeShares
from pica_client.ui.avatar_presenter import AvatarPresenter, CallScene
from pica_client.ui.overlay import (
    control_bar,
    free_shares,
    least_name,
    leave_question,
    names,
    own_face,
    signs,
)
from pica_client.ui.side import side_panel, waiting_page
from pica_client.ui.state import (
    UNKNOWN,
    CallView,
    NoticeBoard,
    OwnFaceView,
    Panel,
    PersonView,
    ViewState,
)
from pica_client.ui.widgets import screen
from pica_client.voice.sound.settings import SoundState
from pica_core.camera import Camera
from pica_core.types import FloatArray

PANELS: tuple[Panel, ...] = (
    names,
    signs,
    own_face,
    waiting_page,
    side_panel,
    control_bar,
    leave_question,
)
"""All panels, in the order in which they are drawn."""
STATUS_PERIOD_S = 0.5
"""How often it is asked how the call stands."""
FACE_LOW_M, FACE_HIGH_M = (-0.085, -0.125, 0.04), (0.085, 0.13, 0.04)
"""Opposite corners of what no name may cover: chin to hairline, ear to ear."""
HALF_WIDTH_M = 0.175
"""A name is no wider than shoulders (chosen)."""
BELOW_CHIN_M = 0.03
GAP_SHARE = 0.1
"""Part of a name's height that stays free around it."""
HIDDEN_SHARE = 0.6
"""A participant hidden by this part has no name: it would stand on the person before them."""
_POINTS = np.array(
    [
        *((x, y, FACE_LOW_M[2]) for x in (-0.085, 0.085) for y in (FACE_LOW_M[1], FACE_HIGH_M[1])),
        (0.0, FACE_LOW_M[1] - BELOW_CHIN_M, FACE_LOW_M[2]),
    ]
)
"""Corners of the face, and where its name begins."""


class CallSurface:
    """Draws the surface of a call.

    Args:
        status: Returns how the call stands, at a time in seconds; None: there is no call.
        has_pointer: There is a window with a pointer.

    Attributes:
        free: What the seats must keep free.
        status: How the call stands, as of the last frame.
    """

    def __init__(self, status: Callable[[float], CallStatus] | None, *, has_pointer: bool) -> None:
        self.free = FreeShares()
        self.status = CallStatus()
        self._ask_status = status
        self._asked_s = -math.inf
        self._has_pointer = has_pointer
        self._board = NoticeBoard()

    def notice(self, text: str, now: float) -> None:
        """Tell the user something for a few seconds."""
        self._board.add((text, "accent"), now)

    def build(
        self,
        now: float,
        scene: CallScene,
        presenter: AvatarPresenter,
        state: ViewState,
        *,
        own: OwnFaceView,
        sound: SoundState | None = None,
    ) -> None:
        """Draw the panels in the frame that was begun."""
        if now - self._asked_s >= STATUS_PERIOD_S:
            self._asked_s = now
            if self._ask_status is not None:
                self.status = self._ask_status(now)
            for line in notices(self.status.news):
                self._board.add(line, now)
        view = CallView(
            people=self._people(now, scene, presenter),
            status=self.status,
            notices=self._board.shown(now),
            has_pointer=self._has_pointer,
            own=own,
            sound=sound,
        )
        self.free = free_shares(state, view)
        for panel in PANELS:
            panel(state, view)

    def _people(
        self, now: float, scene: CallScene, presenter: AvatarPresenter
    ) -> tuple[PersonView, ...]:
        speaking, problems = presenter.speaking(now), presenter.problems
        members = {each.peer_id: each for each in self.status.participants}
        pixels = scene.camera.width / screen()[0]  # a unit
        columns, rows = least_name()
        heads = [placement.world_from_head for placement in scene.placements]
        labels = place_labels(heads, scene.camera, (columns * pixels, rows * pixels))
        people = []
        for face, label in zip(scene.faces, labels, strict=True):
            peer_id = face.peer_id
            member = members.get(peer_id, UNKNOWN)
            if label is not None:
                left, top, right, bottom = (side / pixels for side in label)
                label = (left, top, right, bottom)
            people.append(
                PersonView(
                    peer_id=peer_id,
                    name=face.name,
                    remark=problems.get(peer_id) or face.note or member.line,
                    is_speaking=peer_id in speaking,
                    label=label,
                    member=member,
                )
            )
        return tuple(people)


class _Seen(NamedTuple):
    depth_m: float
    face: Rect
    x_px: float
    """The middle of the name; at the picture's edge it has moved inwards."""
    top_px: float
    """The upper edge of the name, below the chin."""
    half_width_px: float


def place_labels(
    heads: Sequence[FloatArray], camera: Camera, least_px: tuple[float, float]
) -> list[Rect | None]:
    """The part of the picture that each person's name may fill.

    Args:
        heads: World from head, ``[4, 4]`` each.
        least_px: Columns and rows that the shortest name needs.

    Returns:
        Left, top, right and bottom in pixels, y down, in the order of the heads. None for
        heads that cannot be seen, or where there is no room beside the faces.
    """
    seen = [_look(head, camera, least_px) for head in heads]
    found = [each for each in seen if each is not None]
    shown = [each for each in found if _is_seen(each, found, camera)]
    faces = [each.face for each in found]
    return [each and _room(each, faces, shown, camera, least_px) for each in seen]


def _look(head: FloatArray, camera: Camera, least_px: tuple[float, float]) -> _Seen | None:
    """Where a face is on the picture; None behind the camera."""
    pixels, depth = camera.project(_POINTS @ head[:3, :3].T + head[:3, 3])
    if depth.min() <= NEAR_M:
        return None
    (left, top), (right, bottom) = pixels[:4].min(axis=0).tolist(), pixels[:4].max(axis=0).tolist()
    chin_x, chin_y = pixels[4].tolist()
    away_m, inwards = float(depth.mean()), least_px[0] / 2 + GAP_SHARE * least_px[1]
    return _Seen(
        depth_m=away_m,
        face=(left, top, right, bottom),
        x_px=min(max(chin_x, inwards), camera.width - inwards),
        top_px=max(chin_y, bottom),
        half_width_px=HALF_WIDTH_M * float(camera.intrinsics[1, 1]) / away_m,
    )


def _room(
    own: _Seen,
    faces: Sequence[Rect],
    shown: Sequence[_Seen],
    camera: Camera,
    least_px: tuple[float, float],
) -> Rect | None:
    """What is left of the chest beside faces and other names, the middle of it the owner's."""
    gap, x, top = GAP_SHARE * least_px[1], own.x_px, own.top_px
    bottom = top + least_px[1]
    half = min(max(own.half_width_px, least_px[0] / 2), x - gap, camera.width - gap - x)
    for other in shown:  # of those beside each other each has half the way
        if other is not own and abs(other.top_px - top) < least_px[1] + gap:
            half = min(half, abs(other.x_px - x) / 2 - gap)
    for face in faces:
        if common_px((x - half, top, x + half, bottom), face) > 0:
            half = min(half, max(face[0] - gap - x, x - face[2] - gap))
    if own not in shown or 2 * half < least_px[0] or bottom + gap > camera.height:
        return None
    return x - half, top, x + half, bottom


def _is_seen(own: _Seen, everybody: Sequence[_Seen], camera: Camera) -> bool:
    """Whether enough of a face is on the picture and not behind others."""
    left, top, right, bottom = own.face
    area = (right - left) * (bottom - top)
    hidden = area - common_px(own.face, (0.0, 0.0, float(camera.width), float(camera.height)))
    nearer = [each.face for each in everybody if each.depth_m < own.depth_m]
    hidden = max([hidden, *(common_px(own.face, face) for face in nearer)])
    return hidden < HIDDEN_SHARE * area
