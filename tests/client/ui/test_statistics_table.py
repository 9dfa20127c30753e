"""The statistics: what stands in them, and that they are in nobody's face."""

from __future__ import annotations

import numpy as np
import pytest

from pica_client.call.connection_quality import StreamHealth
from pica_client.call.faces import FaceState
from pica_client.call.status import AvatarFigures, CallStatus, PeerStatus
from pica_client.render.scene import Placement, overlap, seat_rects_px
from pica_client.render.seats import LAYOUTS, Layout, ViewState, plan_camera, plan_seats
from pica_client.ui.controls import ControlState
from pica_client.ui.hud import name_items, own_items
from pica_client.ui.hud_frame import seat_rects
from pica_client.ui.statistics_table import (
    draw_shares_ms,
    place_table,
    stacked_size_px,
    summary_item,
    table_item,
)
from pica_client.ui.text_raster import OverlayItem, item_rect_px

pytestmark = pytest.mark.unit

NAMES = ("Ada Lovelace", "Ben", "Chomolungma", "Dee", "Evangeline Moss")
SUMMARY = (
    ("29.9", "fps"), ("draw", "31.4 ms"), ("latency p95", "104 ms"), ("relay", "connected"),
    ("in", "123.4 kbit/s"), ("playout", "104 ms"), ("lost", "1234"), ("refused", "12"),
    ("errors", "12"),
)  # fmt: skip


def everybody(count: int) -> list[FaceState]:
    return [
        FaceState(peer_id=f"peer-{index}", name=name, avatar_id="0" * 64, latent=None)
        for index, name in enumerate(NAMES[:count])
    ]


def full_table(faces: list[FaceState], size: tuple[int, int]) -> list[OverlayItem]:
    figures = {
        face.peer_id: AvatarFigures(
            level=256, decode_ms=123.4, latency_ms=1234.0, num_decoded=9, is_speaking=False
        )
        for face in faces
    }
    health = StreamHealth(received=9, shown=1000, concealed=123, age_s=1.234)
    peers = {face.peer_id: PeerStatus(payload_bps=65_432.1, health=health) for face in faces}
    shares = {face.peer_id: 123.4 for face in faces}
    table = table_item(faces, figures, CallStatus(peers=peers), shares, size)
    return [table, summary_item(SUMMARY, size)]


@pytest.mark.parametrize("pinned", [None, 0])
@pytest.mark.parametrize("size", [(1280, 720), (2560, 1440), (960, 540), (640, 720), (720, 1280)])
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_the_table_covers_no_head_and_no_name(
    count: int, layout: Layout, size: tuple[int, int], pinned: int | None
) -> None:
    faces = everybody(count)
    stacked = stacked_size_px(full_table(faces, size))
    state = ControlState(layout=layout, pinned=None if pinned is None else "peer-0")

    badges = [item_rect_px(item, size) for item in own_items("muted", True, size)]
    place = place_table(stacked, seat_rects(faces, state, size), size, badges)

    plan = plan_seats(layout, count, size[0] / size[1], pinned=pinned, free=place.free)
    table = (place.x_px, place.y_px, place.x_px + stacked[0], place.y_px + stacked[1])
    assert table[0] >= 0
    assert table[2] <= size[0]
    assert table[3] <= size[1]
    rects = seat_rects_px(plan, size)
    assert len(rects) == count
    camera = plan_camera(plan, ViewState(), *size)
    seated = [
        Placement(slot=face.peer_id, world_from_head=seat.astype(np.float32))
        for face, seat in zip(faces, plan.seats, strict=True)
    ]
    notes = {face.peer_id: "poor connection" for face in faces}
    rects += [item_rect_px(item, size) for item in name_items(faces, seated, camera, notes)]
    rects += [item_rect_px(item, size) for item in own_items("muted", True, size)]
    assert not any(overlap(table, rect) for rect in rects)


def test_on_a_narrow_picture_the_figures_of_the_call_take_more_lines() -> None:
    wide, narrow = summary_item(SUMMARY, (1280, 720)), summary_item(SUMMARY, (640, 720))
    assert len(wide.lines) == 1
    assert len(narrow.lines) > 1
    assert [text for row in narrow.lines for text in row] == list(wide.lines[0])


def test_a_line_for_each_participant_has_all_figures() -> None:
    table, _ = full_table(everybody(2), (1280, 720))
    head, ada, ben = table.lines
    assert len(head) == len(ada) == len(ben) == 8
    assert ada == ("Ada Lovelace", "256", "123.4", "123.4", "65.4", "1234", "1234", "12.3 %")


def test_what_is_not_known_is_a_dash() -> None:
    table = table_item(everybody(1), {}, CallStatus(), {}, (1280, 720))
    assert table.lines[1][1:] == ("-",) * 7


def test_a_latency_between_two_machines_is_not_shown() -> None:
    figures = {
        "peer-0": AvatarFigures(
            level=64, decode_ms=1.0, latency_ms=-4e9, num_decoded=1, is_speaking=False
        )
    }
    table = table_item(everybody(1), figures, CallStatus(), {}, (1280, 720))
    assert table.lines[1][5] == "-"


def test_drawing_time_is_dealt_out_by_the_place_on_the_screen() -> None:
    rects = {"near": (0.0, 0.0, 30.0, 30.0), "far": (50.0, 0.0, 60.0, 10.0), "off": None}
    shares = draw_shares_ms(rects, 10.0)
    assert shares["near"] == pytest.approx(9.0)
    assert shares["far"] == pytest.approx(1.0)
    assert shares["off"] == 0.0
    assert draw_shares_ms(rects, None) == {}
    assert draw_shares_ms({}, 3.0) == {}
