"""Measure on a machine with a GPU what decoding in shaders gains, and print one JSON line.

    python scripts/gpu_table.py              a minute and a half
    python scripts/gpu_table.py --quick      small images, few of them: whether it runs

Every head is its own person, changes in every image and is drawn whole; ONNX Runtime decodes in
worker threads beside drawing. For each case, in milliseconds of an image with everybody decoded:

    decode    all heads, in worker threads or by the GPU's clock
    draw      by the GPU's clock
    thread    processor time of the drawing thread: plan, submitted decodes, uploads, drawing
"""

import argparse
import json
import os
import time
from collections import defaultdict
from statistics import median
from typing import Any

import moderngl
import numpy as np

from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool, num_workers
from pica_client.render.draw_clock import DrawClock
from pica_client.render.gpu_decoder import GpuDecoder
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, head_matrix
from pica_client.render.seats import plan_seats
from pica_client.render.views import ViewState, plan_camera, stereo_cameras
from pica_client.schedule.head import Choice, Head
from pica_client.schedule.scheduler import Scheduler, requests_of
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar, load_avatar, shipped_avatar_files
from pica_core.avatar.spec import MAP_SIZE
from pica_core.gl import create_context, wait_for_gpu

CASES = (((1920, 1080), 1, (1, 5, 20)), ((3664, 1920), 2, (5, 20)))
"""Size of the image, eyes that share it, heads."""
QUICK = (((160, 90), 1, (1, 2)), ((240, 120), 2, (2,)))
WHOLE = Choice(MAP_SIZE, "both", 1.0, 1)
EYE_DISTANCE_M = 0.064
ROUNDS, NUM_FACES, LEAST_IMAGES = 2, 8, 12
AHEAD = 4
"""Images that are submitted before the GPU is waited for."""


class Scene:
    """Heads on a grid before one or two eyes, decoded in one way."""

    def __init__(
        self,
        context: moderngl.Context,
        mode: str,
        size: tuple[int, int],
        num_eyes: int,
        avatars: list[Avatar],
    ) -> None:
        self._context = context
        self._renderer = Renderer(context, size, RenderOptions(fade_busts=True))
        self._pool = DecodePool(OnnxDecoder, workers=num_workers(os.cpu_count()))
        self._shaders = GpuDecoder(context, self._renderer)
        self._decoder = self._shaders if mode == "gpu" else self._pool
        self._size = (size[0] // num_eyes, size[1])
        seats = plan_seats("grid", len(avatars), self._size[0] / size[1])
        camera = plan_camera(seats, ViewState(), *self._size)
        self._eyes = stereo_cameras(camera, EYE_DISTANCE_M, 1.0) if num_eyes == 2 else (camera,)
        self._heads: dict[str, Head] = {}
        for index, (avatar, seat) in enumerate(zip(avatars, seats.seats, strict=True)):
            slot = f"head {index}"
            place = head_matrix(seat, np.zeros(3), np.zeros(3))
            self._heads[slot] = Head(slot=slot, avatar=avatar, world_from_head=place)
            self._renderer.add_avatar(slot, avatar)
            self._decoder.add(slot, avatar)
        arkit = np.random.default_rng(5).uniform(0, 0.7, (NUM_FACES, 52)).astype(np.float32)
        self._faces = [ExpressionEncoder(avatar).encode(arkit) for avatar in avatars]
        self._scheduler, self._turn = Scheduler(), 0
        self._clock: DrawClock[int] = DrawClock(context)
        self._took: dict[str, list[float]] = defaultdict(list)

    def close(self) -> None:
        """Stop decoding, and free what it holds on the GPU."""
        self._pool.close()
        self._shaders.close()
        self._renderer.close()

    def row(self, seconds: float) -> dict[str, Any]:
        """All figures; times are medians, milliseconds."""
        self._repeat(0.5 * seconds)
        self._took.clear()
        begin_s, thread_s = time.perf_counter(), time.thread_time()
        count = self._repeat(seconds)
        return {
            "images_s": round(count / (time.perf_counter() - begin_s), 1),
            "decodes_an_image": round(len(self._took["decode"]) / count, 2),
            "thread_ms": round(1e3 * (time.thread_time() - thread_s) / count, 3),
            **{f"{name}_ms": round(1e3 * median(t), 3) for name, t in self._took.items() if t},
        }

    def _repeat(self, seconds: float) -> int:
        end_s, count = time.perf_counter() + seconds, 0
        while time.perf_counter() < end_s or count < LEAST_IMAGES:
            self._image()
            count += 1
            if count % AHEAD == 0:
                wait_for_gpu(self._context)
        return count

    def _image(self) -> None:
        heads, now = list(self._heads.values()), time.perf_counter()
        self._turn += 1
        for head, faces in zip(heads, self._faces, strict=True):
            head.latent = faces[self._turn % NUM_FACES]
        self._scheduler.plan_view(heads, self._eyes, self._size, 1.0, now)
        for head in heads:
            head.choice = WHOLE
        for head, request in requests_of(heads, now):
            self._decoder.submit(head.slot, request)
        for result in self._decoder.take_results():
            assert result.maps is not None, result.error
            if result.maps.expression_map is not None:
                maps = result.maps
                self._renderer.update_maps(result.slot, maps.position_map, maps.expression_map)
            self._took["decode"].append(len(heads) * result.decode_s)
            self._scheduler.note_decoded(self._heads[result.slot], result, 0.0)
        placements = [
            Placement(slot=head.slot, world_from_head=head.world_from_head) for head in heads
        ]
        self._renderer.forget_frame()
        with self._clock.around(self._turn):
            self._renderer.draw(placements, *self._eyes)
        self._took["draw"] += [drawn_s for _, drawn_s in self._clock.take()]


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small images, few of them")
    parser.add_argument("--seconds", type=float, default=2.0, help="of each measurement")
    options = parser.parse_args()
    seconds = 0.1 if options.quick else options.seconds
    context, shipped = create_context(), [load_avatar(path) for path in shipped_avatar_files()]
    rows = []
    for size, num_eyes, counts in QUICK if options.quick else CASES:
        for count in counts:
            avatars = [shipped[index % len(shipped)] for index in range(count)]
            for mode in ("cpu", "gpu") * ROUNDS:
                scene = Scene(context, mode, size, num_eyes, avatars)
                case = {"size": size, "eyes": num_eyes, "heads": count, "mode": mode}
                rows.append(case | scene.row(seconds))
                scene.close()
                print(json.dumps(rows[-1]), flush=True)
    print(json.dumps({"gl_renderer": context.info["GL_RENDERER"], "rows": rows}))


if __name__ == "__main__":
    main()
