"""What the window's surface costs in a call: building it and painting it, beside the heads.

    LP_NUM_THREADS=2 python scripts/surface_cost.py

Five generated performances on 1280 x 720, off the screen, with the bar in sight because the pointer
moves: once as the call stands, once with each panel at the right. `build_ms` is what collects and
sets the shapes, `paint_ms` what draws them, waiting for the GPU before and after. Lower quartile
and median of the frames, on a machine that should do nothing else. Prints one JSON line a row.
"""

import json
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from call_pictures import Performers

from pica_client.avatars.library import AvatarLibrary
from pica_client.call.status import CallStatus
from pica_client.stats import describe_machine
from pica_client.ui.call_surface import CallSurface
from pica_client.ui.controls import Side
from pica_client.ui.events import MouseMoved
from pica_client.ui.surface.painter import Painter
from pica_client.ui.viewer import Viewer
from pica_client.ui.viewer_options import ViewerOptions
from pica_core.gl import wait_for_gpu

SIZE = (1280, 720)
WARM_UP, FRAMES = 20, 120
SIDES: tuple[Side, ...] = ("none", "participants", "settings")


def timed(call: Callable[..., Any], times_s: list[float], wait: Callable[[], None]) -> Any:
    """The same function; each call notes how long it took."""

    def timing(*arguments: Any, **options: Any) -> Any:
        wait()
        began_s = time.perf_counter()
        found = call(*arguments, **options)
        wait()
        times_s.append(time.perf_counter() - began_s)
        return found

    return timing


def measure(library: AvatarLibrary, side: Side) -> dict[str, Any]:
    """The times of one state of a call."""
    times_s: dict[str, list[float]] = {"build": [], "paint": []}
    options = ViewerOptions(headless=True, size=SIZE, frame_budget_ms=1000)
    status = CallStatus(room="standup", is_encrypted=True, invitation="pica://127.0.0.1/standup")
    build, paint = CallSurface.build, Painter.paint
    with Viewer(
        Performers(library, 5), options, status=lambda now: status, clock=lambda: 0.0
    ) as viewer:
        viewer.controls.state = replace(viewer.controls.state, side=side)

        def paint_and_wait(painter: Painter, *arguments: Any, **given: Any) -> None:
            wait = partial(wait_for_gpu, painter._context)
            timed(paint, times_s["paint"], wait)(painter, *arguments, **given)

        CallSurface.build = timed(build, times_s["build"], lambda: None)  # type: ignore[method-assign]
        Painter.paint = paint_and_wait  # type: ignore[method-assign, assignment]
        try:
            for number in range(WARM_UP + FRAMES):
                viewer.receive(MouseMoved(640 + number % 2, 500))
                viewer.step(number / 30)
        finally:
            CallSurface.build, Painter.paint = build, paint  # type: ignore[method-assign]
    found: dict[str, Any] = {"metric": "surface", "side": side}
    both = np.array([times_s["build"][WARM_UP:], times_s["paint"][WARM_UP:]]) * 1e3
    for name, times_ms in zip(
        ("build_ms", "paint_ms", "total_ms"), (*both, both.sum(0)), strict=True
    ):
        found[name] = [round(float(q), 2) for q in np.percentile(times_ms, (25, 50))]
    return found | {"machine": describe_machine()}


def main() -> None:
    """Measure all of them."""
    library = AvatarLibrary()
    for side in SIDES:
        print(json.dumps(measure(library, side)))
    library.close()


if __name__ == "__main__":
    main()
