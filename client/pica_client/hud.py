"""What is written over the picture, and where: names under heads, the statistics panel, the keys.
Pure."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

from pica_client.faces import FaceState
from pica_client.scene import Placement, label_anchor_px
from pica_client.typesetting import OverlayItem
from pica_core.camera import Camera

MAX_NAME_LENGTH = 32
NOTE_COLUMNS = 24
NOTE_LINES = 4
"""A note under a name is wrapped, so that it stays within its seat."""
STATUS_NOTE = {"waiting": "waiting", "stale": "no signal", "away": "away"}
"""What stands under a name; live and concealed faces need no note."""
KEY_HELP = (
    ("Keys", ""),
    ("drag", "look around"),
    ("wheel", "come closer"),
    ("R", "reset the view"),
    ("S", "statistics"),
    ("F11", "full screen"),
    ("H", "this help"),
    ("Q, Esc", "leave"),
)


def name_items(
    faces: Sequence[FaceState],
    placements: Sequence[Placement],
    camera: Camera,
    problems: Mapping[str, str],
) -> list[OverlayItem]:
    """Names below the heads, with a note on those that are not live.

    Args:
        faces: Who is there.
        placements: Where their heads are, in the same order.
        camera: The viewer's.
        problems: Why an avatar cannot be drawn, by peer id.
    """
    items = []
    for face, placement in zip(faces, placements, strict=True):
        anchor = label_anchor_px(camera, placement.world_from_head)
        if anchor is None:
            continue
        lines = [(_cut(face.name, MAX_NAME_LENGTH), "")]
        note = problems.get(face.peer_id) or face.note or STATUS_NOTE.get(face.status, "")
        wrapped = textwrap.wrap(note, NOTE_COLUMNS, max_lines=NOTE_LINES, placeholder=" …")
        lines += [("", line) for line in wrapped]
        items.append(
            OverlayItem(
                key=f"name:{face.peer_id}",
                lines=tuple(lines),
                x_px=anchor[0],
                y_px=anchor[1],
                size_px=_type_size_px(camera.height),
            )
        )
    return items


def statistics_item(lines: tuple[tuple[str, str], ...], size: tuple[int, int]) -> OverlayItem:
    """The statistics panel, in the upper left corner."""
    return _panel("statistics", lines, size, at_right=False)


def help_item(size: tuple[int, int]) -> OverlayItem:
    """The list of keys, in the upper right corner."""
    return _panel("help", KEY_HELP, size, at_right=True)


def _panel(
    key: str, lines: tuple[tuple[str, str], ...], size: tuple[int, int], *, at_right: bool
) -> OverlayItem:
    type_px = _type_size_px(size[1])
    margin = 0.8 * type_px
    return OverlayItem(
        key=key,
        lines=lines,
        x_px=size[0] - margin if at_right else margin,
        y_px=margin,
        style="panel",
        is_right_aligned=at_right,
        size_px=max(11, round(0.86 * type_px)),
    )


def _type_size_px(height_px: int) -> int:
    """Type that reads alike on small and large pictures (chosen: 15 px at 540 rows)."""
    return min(max(12, round(height_px / 36)), 60)


def _cut(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"
