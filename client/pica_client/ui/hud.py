"""What is written over the picture, and where: names under heads, banners, badges, the keys. Pure.

The statistics are in `statistics_table`.
"""

import textwrap
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from pica_client.call.connection_quality import Quality
from pica_client.call.faces import FaceState
from pica_client.call.status import CallStatus
from pica_client.render.scene import Placement, Rect, label_anchor_px, overlap
from pica_client.ui.controls import OwnFace, help_lines
from pica_client.ui.text_raster import OverlayItem, Tone, item_rect_px, item_size_px
from pica_core.camera import Camera

MAX_NAME_LENGTH = 32
NOTE_COLUMNS = 24
NOTE_LINES = 4
"""A note under a name is wrapped, so that it stays within its seat."""
STATUS_NOTE = {"waiting": "waiting", "stale": "no signal", "away": "away"}
"""What stands under a name; live and concealed faces need no note."""
POOR_NOTE = "poor connection"
BANNER_AFTER_S = 1.0
"""A connection that comes back sooner is not worth a word."""
OWN_BADGES: dict[OwnFace, tuple[str, Tone]] = {
    "sent": ("Your face is sent", "good"),
    "frozen": ("Your face is frozen", "warning"),
    "muted": ("Your face is not sent", "alert"),
}


def name_items(
    faces: Sequence[FaceState],
    placements: Sequence[Placement],
    camera: Camera,
    problems: Mapping[str, str],
    *,
    speaking: Collection[str] = (),
    quality: Mapping[str, Quality] | None = None,
) -> list[OverlayItem]:
    """Names below the heads, with a dot on who speaks and a note on who is not well to be seen.

    Args:
        faces: Who is there.
        placements: Where their heads are, in the same order.
        camera: The viewer's.
        problems: Why an avatar cannot be drawn, by peer id.
        speaking: Peers who seem to speak.
        quality: Of their connections, by peer id; only a poor one is worth a word.
    """
    items = []
    for face, placement in zip(faces, placements, strict=True):
        anchor = label_anchor_px(camera, placement.world_from_head)
        if anchor is None:
            continue
        is_poor = (quality or {}).get(face.peer_id) == "poor"
        note = problems.get(face.peer_id) or face.note or STATUS_NOTE.get(face.status, "")
        note = note or (POOR_NOTE if is_poor else "")
        lines = [(_cut(face.name, MAX_NAME_LENGTH), "")]
        wrapped = textwrap.wrap(note, NOTE_COLUMNS, max_lines=NOTE_LINES, placeholder=" …")
        lines += [("", line) for line in wrapped]
        dot: Tone | None = "good" if face.peer_id in speaking else None
        items.append(
            OverlayItem(
                key=f"name:{face.peer_id}",
                lines=tuple(lines),
                x_px=anchor[0],
                y_px=anchor[1],
                size_px=type_size_px(camera.height),
                dot="alert" if is_poor else dot,
            )
        )
    return items


def help_item(size: tuple[int, int], own_face: OwnFace = "none") -> OverlayItem:
    """The list of keys, in the upper right corner."""
    type_px = type_size_px(size[1])
    margin = margin_px(size)
    return OverlayItem(
        key="help",
        lines=help_lines(own_face),
        x_px=size[0] - margin,
        y_px=margin,
        style="panel",
        is_right_aligned=True,
        size_px=max(11, round(0.86 * type_px)),
    )


def banner_items(
    status: CallStatus,
    own_face: OwnFace,
    notice: str,
    size: tuple[int, int],
    *,
    taken: Rect | None = None,
) -> list[OverlayItem]:
    """What everybody should see: the connection is gone, or our own is poor, and what was just
    done. At the upper edge, at most one.

    Args:
        status: How the call stands.
        own_face: What becomes of the user's own.
        notice: What was just done; empty for nothing.
        size: Columns and rows of the picture.
        taken: Where a panel is, pixels; at the upper edge the banner keeps out of its way.
    """
    found: tuple[str, str, Tone] | None = None
    if not status.is_connected and status.away_s >= BANNER_AFTER_S:
        found = ("Connection lost", f"  coming back … {status.away_s:.0f} s", "alert")
    elif status.is_muted_by_admin and own_face != "none":
        found = ("An admin has muted your face", "", "warning")
    elif notice:
        found = (notice, "", "accent")
    elif status.own_quality == "poor":
        found = ("Your connection is poor", "", "warning")
    if found is None:
        return []
    text, more, tone = found
    item = OverlayItem(
        key="banner",
        lines=((text, more),) if more else ((text,),),
        x_px=size[0] / 2,
        y_px=margin_px(size),
        style="banner",
        size_px=type_size_px(size[1]),
        tone=tone,
        dot=tone if tone != "accent" else None,
    )
    if taken is not None and overlap(item_rect_px(item, size), taken):
        at_left, at_right = taken[0], size[0] - taken[2]
        middle = taken[0] / 2 if at_left > at_right else (taken[2] + size[0]) / 2
        item = replace(item, x_px=middle)
    return [item]


def own_items(
    own_face: OwnFace, is_recording: bool, size: tuple[int, int], *, is_connected: bool = True
) -> list[OverlayItem]:
    """The user's own state, in the lower corners: what becomes of their face, and whether the
    picture is recorded."""
    items = []
    if own_face in OWN_BADGES:
        text, tone = OWN_BADGES[own_face if is_connected else "muted"]
        items.append(_badge("own", text, tone, size, is_left=True))
    if is_recording:
        items.append(_badge("recording", "Recording", "alert", size, is_left=False))
    return items


def _badge(key: str, text: str, tone: Tone, size: tuple[int, int], *, is_left: bool) -> OverlayItem:
    item = OverlayItem(
        key=key, lines=((text,),), x_px=0, y_px=0, size_px=type_size_px(size[1]), dot=tone
    )
    width, height = item_size_px(item)
    margin = margin_px(size)
    middle = margin + width / 2
    return replace(
        item,
        x_px=middle if is_left else size[0] - middle,
        y_px=size[1] - margin - height,
    )


def type_size_px(height_px: int) -> int:
    """Type that reads alike on small and large pictures (chosen: 15 px at 540 rows)."""
    return min(max(12, round(height_px / 36)), 60)


def margin_px(size: tuple[int, int]) -> float:
    """Between panels and the edges of the picture."""
    return 0.8 * type_size_px(size[1])


def _cut(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"
