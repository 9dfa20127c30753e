"""The draw clock tells of every frame once, late, in order, and without the first ones."""

import moderngl
import pytest

from pica_client.render.draw_clock import DEPTH, WARM_UP_FRAMES, DrawClock

pytestmark = pytest.mark.render


def test_frames_come_back_in_order_with_plausible_times_and_without_the_first_ones(
    context: moderngl.Context,
) -> None:
    target = context.simple_framebuffer((64, 64))
    target.use()
    clock: DrawClock[int] = DrawClock(context)
    told = []
    for frame in range(20):
        with clock.around(frame):
            target.clear(0.1, 0.2, 0.3)
        told += clock.take()
    assert [frame for frame, _ in told] == list(range(WARM_UP_FRAMES, 20 - DEPTH))
    assert all(0 < seconds < 4 for _, seconds in told)
    assert clock.take() == []
