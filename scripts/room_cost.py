"""What the room costs in a call of five, beside what the size of the heads costs.

    LP_NUM_THREADS=0 python scripts/room_cost.py

Neutral faces at the full level on 1280 x 720, off the screen, in turns: as a call stands, with and
without a room; the same from so far away that heads cover about half the pixels; while a glow
changes; and while the view turns. Milliseconds of processor time a picture, lower quartile and
median of the rounds, which other work on the machine hardly moves. Prints one JSON line a row.
"""

import json
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pica_client.bench.harness import gl_context
from pica_client.decode.decoder import OnnxDecoder
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.room import EMPTY_ROOM, Room
from pica_client.render.scene import Placement, head_matrix, view_direction
from pica_client.render.seats import plan_seats
from pica_client.render.views import ViewState, plan_camera
from pica_client.stats import describe_machine
from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar
from pica_core.avatar.shipped import shipped_avatar_files
from pica_core.gl import wait_for_gpu

SIZE, PEOPLE, FAR_ZOOM = (1280, 720), 5, 0.7
ROUNDS, PICTURES = 9, 6


def main() -> None:
    """Measure all of them."""
    plan = plan_seats("line", PEOPLE, SIZE[0] / SIZE[1])
    with gl_context() as context:
        renderer = Renderer(context, SIZE, RenderOptions(fade_busts=True))
        heads = []
        camera = plan_camera(plan, ViewState(), *SIZE)
        for seat, file in zip(plan.seats, shipped_avatar_files(), strict=False):
            avatar, matrix = load_avatar(file), head_matrix(seat, (0, 0, 0), (0, 0, 0))
            renderer.add_avatar(file.stem, avatar)
            latent = ExpressionEncoder(avatar).encode(np.zeros(NUM_ARKIT, np.float32))
            maps = OnnxDecoder(avatar).decode(latent, view_direction(matrix, camera.centre_m))
            renderer.update_maps(file.stem, maps.position_map, maps.expression_map)
            heads.append(Placement(slot=file.stem, world_from_head=matrix))
        lit = Room(seats_m=plan.places_m, speaking=(0.0,) * PEOPLE)

        def still(_: int) -> tuple[ViewState, Room]:
            return ViewState(), lit

        def far(_: int) -> tuple[ViewState, Room]:
            return ViewState(zoom=FAR_ZOOM), lit

        def glowing(number: int) -> tuple[ViewState, Room]:
            return ViewState(), replace(lit, speaking=(number % 7 / 7, *lit.speaking[1:]))

        def turning(number: int) -> tuple[ViewState, Room]:
            return ViewState(yaw=0.02 * (number % 9 - 4)), lit

        def draw(state: Callable[[int], tuple[ViewState, Room]], kind: str, number: int) -> int:
            view, room = state(number)
            stats = renderer.draw(
                [] if kind == "room alone" else heads,
                plan_camera(plan, view, *SIZE),
                room=EMPTY_ROOM if kind == "no room" else room,
                count_pixels=number < 0,
            )
            return stats.shaded_pixels or 0

        took_ms: dict[tuple[str, str], list[float]] = {}
        for _ in range(1 + ROUNDS):
            for state in (still, far, glowing, turning):
                for kind in ("both", "no room", "room alone"):
                    draw(state, kind, 0)
                    wait_for_gpu(context)
                    began_s = time.process_time()
                    for number in range(1, 1 + PICTURES):
                        draw(state, kind, number)
                    wait_for_gpu(context)
                    ms = (time.process_time() - began_s) / PICTURES * 1e3
                    took_ms.setdefault((state.__name__, kind), []).append(ms)
        pixels = {state.__name__: draw(state, "both", -1) for state in (still, far)}
        for (name, kind), every in took_ms.items():
            low, middle = np.percentile(every[1:], (25, 50)).round(2).tolist()
            row = {"metric": "room", "view": name, "drawn": kind, "ms": [low, middle]}
            print(json.dumps(row | {"pixels": pixels.get(name), "machine": describe_machine()}))


if __name__ == "__main__":
    main()
