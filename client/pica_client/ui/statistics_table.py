"""The statistics: a table with a line for each participant, where it covers no face. Pure.

Columns: the level of detail and what its decode costs; its share of the drawing time; what its
stream takes; how late and how old it is; how much of it had to be made up.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from pica_client.call.faces import FaceState
from pica_client.call.status import AvatarFigures, CallStatus, PeerStatus
from pica_client.render.scene import Rect, overlap
from pica_client.render.seats import MAX_FREE, FreeShares
from pica_client.ui.hud import margin_px, type_size_px
from pica_client.ui.text_raster import OverlayItem, item_size_px

HEAD = ("", "level", "decode ms", "draw ms", "kbit/s", "latency ms", "age ms", "concealed")
MAX_NAME_LENGTH = 14
MIN_TYPE_PX = 7
"""Smaller type than this cannot be read; a table that is wider still is cut by the edge."""
MAX_ROWS = 16
"""Participants that a table shows."""
NO_FIGURE = "-"
MAX_LATENCY_MS = 10_000.0
"""Beyond it sender and receiver have different clocks, and the figure means nothing."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TablePlace:
    """Where the statistics stand."""

    x_px: float
    y_px: float
    """Upper left corner."""
    free: FreeShares
    """What the seats must keep free for it."""


def table_item(
    faces: Sequence[FaceState],
    figures: Mapping[str, AvatarFigures],
    status: CallStatus,
    draw_shares_ms: Mapping[str, float],
    size: tuple[int, int],
) -> OverlayItem:
    """The table, still without a place.

    Args:
        faces: Who is there.
        figures: What each avatar costs, by peer id.
        status: How the call stands.
        draw_shares_ms: Each avatar's share of the drawing time, by peer id.
        size: Columns and rows of the picture.
    """
    rows: list[tuple[str, ...]] = [HEAD]
    for face in faces[:MAX_ROWS]:
        peer = status.peers.get(face.peer_id, PeerStatus())
        found = figures.get(face.peer_id)
        bits = None if peer.payload_bps is None else peer.payload_bps / 1e3
        concealed = peer.health.concealed / peer.health.shown if peer.health.shown else None
        latency = None if found is None else found.latency_ms
        if latency is not None and not 0 <= latency <= MAX_LATENCY_MS:
            latency = None
        rows.append(
            (
                face.name[:MAX_NAME_LENGTH],
                NO_FIGURE if found is None or found.level is None else str(found.level),
                _figure(None if found is None else found.decode_ms, 1),
                _figure(draw_shares_ms.get(face.peer_id), 1),
                _figure(bits, 1),
                _figure(latency, 0),
                _figure(peer.health.age_s * 1e3 if peer.health.shown else None, 0),
                NO_FIGURE if concealed is None else f"{concealed * 100:.1f} %",
            )
        )
    item = OverlayItem(
        key="statistics",
        lines=tuple(rows),
        x_px=0,
        y_px=0,
        style="table",
        size_px=_type_px(size),
    )
    while _is_too_wide(item, size) and item.size_px > MIN_TYPE_PX:
        item = replace(item, size_px=item.size_px - 1)
    return item


def summary_item(lines: Sequence[tuple[str, str]], size: tuple[int, int]) -> OverlayItem:
    """The figures of the whole call, to stand under the table: in one line if that is not too
    wide."""
    texts = [f"{name} {value}".strip() for name, value in lines] or [NO_FIGURE]
    for columns in range(len(texts), 0, -1):
        rows = tuple(tuple(texts[at : at + columns]) for at in range(0, len(texts), columns))
        item = OverlayItem(
            key="statistics-summary",
            lines=rows,
            x_px=0,
            y_px=0,
            style="table",
            size_px=_type_px(size),
            num_heads=len(rows),
        )
        if not _is_too_wide(item, size):
            break
    return item


def stacked_size_px(items: Sequence[OverlayItem]) -> tuple[int, int]:
    """Columns and rows of items one below the other."""
    sizes = [item_size_px(item) for item in items]
    return max(width for width, _ in sizes), sum(height for _, height in sizes)


def place_table(
    table_size: tuple[int, int],
    faces: Sequence[Rect],
    size: tuple[int, int],
    others: Sequence[Rect] = (),
) -> TablePlace:
    """A place for the statistics where no head or name is, as the seats are.

    Tried are the corners and the middles of the upper and lower edges. If each of them is in
    somebody's face, the heads are to move down and leave a strip at the upper edge.

    Args:
        table_size: Columns and rows of the statistics, pixels.
        faces: Where heads and names are.
        size: Of the picture.
        others: What else should not be covered, if there is a choice.
    """
    (width, height), (columns, rows), margin = table_size, size, margin_px(size)
    xs = (margin, columns - margin - width, (columns - width) / 2)
    ys = (margin, rows - margin - height)
    for y in ys:
        for x in xs:
            rect = (x, y, x + width, y + height)
            if x >= 0 and not any(overlap(rect, taken) for taken in (*faces, *others)):
                return TablePlace(x_px=x, y_px=y, free=FreeShares())
    share = min(math.ceil(height + 1.5 * margin) / rows, MAX_FREE)
    return TablePlace(x_px=margin, y_px=margin, free=FreeShares(top=share))


def draw_shares_ms(rects: Mapping[str, Rect | None], draw_ms: float | None) -> dict[str, float]:
    """The drawing time dealt out by the pixels that each head may cover: most of it is spent per
    pixel. An estimate; the GPU is not asked head by head.

    Args:
        rects: Where the heads are on the picture, pixels; None off the screen.
        draw_ms: Of the whole picture.
    """
    areas = {
        peer_id: 0.0 if rect is None else max(rect[2] - rect[0], 0) * max(rect[3] - rect[1], 0)
        for peer_id, rect in rects.items()
    }
    total = sum(areas.values())
    if draw_ms is None or total <= 0:
        return {}
    return {peer_id: draw_ms * area / total for peer_id, area in areas.items()}


def _figure(value: float | None, digits: int) -> str:
    return NO_FIGURE if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def _type_px(size: tuple[int, int]) -> int:
    return max(11, round(0.72 * type_size_px(size[1])))


def _is_too_wide(item: OverlayItem, size: tuple[int, int]) -> bool:
    return item_size_px(item)[0] > size[0] - 2 * margin_px(size)
