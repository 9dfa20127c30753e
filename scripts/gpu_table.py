"""Measure decoding by ONNX Runtime and in shaders in turns, with one JSON line for each case.

    PYTHONPATH=client:pica_core:protocol python scripts/gpu_table.py              three minutes
    PYTHONPATH=client:pica_core:protocol python scripts/gpu_table.py --quick      small images

Every head is its own person, changes in every image and is drawn whole. In milliseconds an image:

    decode    ONNX Runtime on one thread; in shaders, by the GPU's clock
    python    the same on this thread: all of it, or submitting alone
    upload    of maps, by this thread; nothing in shaders (`upload_kb` is what goes to the GPU)
    submit    drawing until it is handed to the driver
    draw      by the GPU's clock
    thread    processor time of this thread in a call: plan, decode, upload, submit

``images_s`` is decoding and drawing one after the other, ``call_images_s`` what a call does: beside
each other in worker threads where ONNX Runtime decodes. The first lines are the largest differences
from numpy. Needs moderngl, numpy, safetensors, onnx and onnxruntime.
"""

import argparse
import json
import os
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np

from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool, num_workers
from pica_client.decode.request import DecodeRequest
from pica_client.render.draw_clock import DrawClock
from pica_client.render.gpu_decoder import GpuDecoder, draws_floats
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, head_matrix
from pica_client.render.seats import plan_seats
from pica_client.render.views import EYE_DISTANCE_M, ViewState, plan_camera, stereo_cameras
from pica_client.schedule.frame_planner import FramePlanner
from pica_client.schedule.head import Head
from pica_client.schedule.scheduler import Scheduler, SchedulerOptions
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar, load_avatar
from pica_core.avatar.shipped import shipped_avatar_files
from pica_core.gl import create_context, wait_for_gpu
from pica_core.reference.decoders import decode_expression_map, decode_position_map
from pica_core.types import FloatArray

CASES = (((1920, 1080), 1, (1, 5, 20)), ((3664, 1920), 2, (5, 20)))
QUICK = (((160, 90), 1, (1, 2)), ((240, 120), 2, (2,)))
NUM_FACES = 8
FRONT = np.array([0, 0, 1], np.float32)


def main() -> None:
    """Print all lines."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small images, few of them")
    parser.add_argument("--seconds", type=float, default=1.2, help="of each measurement")
    options = parser.parse_args()
    begin_s, seconds = time.monotonic(), 0.1 if options.quick else options.seconds
    cases = QUICK if options.quick else CASES
    context = create_context()
    print_line(
        gl_renderer=context.info["GL_RENDERER"], cores=os.cpu_count(), floats=draws_floats(context)
    )
    files = shipped_avatar_files()
    most = max(count for _, _, counts in cases for count in counts)
    avatars = [load_avatar(files[index % len(files)]) for index in range(most)]
    for avatar in avatars[:1] if options.quick else avatars[: len(files)]:
        print_line(**errors(context, avatar))
    decoders = [OnnxDecoder(avatar) for avatar in avatars]
    for size, num_eyes, counts in cases:
        for count in counts:
            with Scene(context, size, num_eyes, avatars[:count], decoders) as scene:
                for _ in range(2):
                    for mode in ("cpu", "gpu"):
                        print_line(
                            size=size, eyes=num_eyes, heads=count, **scene.row(mode, seconds)
                        )
    print_line(seconds=round(time.monotonic() - begin_s, 1))


def print_line(**values: Any) -> None:
    """One JSON line, at once."""
    print(json.dumps(values), flush=True)


def errors(context: Any, avatar: Avatar) -> dict[str, Any]:
    """The largest difference of both maps from numpy, at each level: in shaders, and by ONNX."""
    found: dict[str, Any] = {"avatar": avatar.manifest.name}
    latent = faces_of(avatar, 1)[0]
    with (
        Renderer(context, (64, 64)) as renderer,
        GpuDecoder(context, renderer.map_targets) as decoder,
    ):
        renderer.add_avatar("head", avatar)
        assert decoder.add("head", avatar)
        onnx = OnnxDecoder(avatar)
        for level in avatar.levels:
            decoder.submit("head", DecodeRequest(latent, FRONT, 0, level))
            decoder.take_results()
            maps = renderer.read_maps("head")
            wanted = (
                decode_position_map(avatar, latent, level),
                decode_expression_map(avatar, latent, FRONT, level),
            )
            other = onnx.decode(latent, FRONT, level)
            for name, made in (("gpu", maps), ("onnx", (other.position_map, other.expression_map))):
                for kind, one, true in zip(("m", "code"), made, wanted, strict=True):
                    found[f"{name}_{level}_{kind}"] = float(np.abs(one - true).max())
    return found


def faces_of(avatar: Avatar, count: int) -> list[FloatArray]:
    """Latents of a face that moves."""
    rng, encoder = np.random.default_rng(5), ExpressionEncoder(avatar)
    return [encoder.encode(rng.uniform(0, 0.7, 52).astype(np.float32)) for _ in range(count)]


class Scene:
    """Heads on a grid before one or two eyes, each of them in two slots: one a decoder."""

    def __init__(
        self,
        context: Any,
        size: tuple[int, int],
        num_eyes: int,
        avatars: list[Avatar],
        decoders: list[OnnxDecoder],
    ) -> None:
        self._context, self._avatars, self._decoders = context, avatars, decoders
        self._renderer = Renderer(context, size, RenderOptions(fade_busts=True))
        self._shaders = GpuDecoder(context, self._renderer.map_targets)
        self._workers = num_workers(os.cpu_count())
        self._size = (size[0] // num_eyes, size[1])
        plan = plan_seats("grid", count=len(avatars), aspect=self._size[0] / size[1])
        camera = plan_camera(plan, ViewState(), *self._size)
        self._eyes = stereo_cameras(camera, EYE_DISTANCE_M, 1.0) if num_eyes == 2 else (camera,)
        self._matrices = [head_matrix(seat, [0, 0, 0], [0, 0, 0]) for seat in plan.seats]
        self._faces = [faces_of(avatar, NUM_FACES) for avatar in avatars]
        for index, avatar in enumerate(avatars):
            for mode in ("cpu", "gpu"):
                self._renderer.add_avatar(f"{mode} {index}", avatar)
            self._shaders.add(f"gpu {index}", avatar)
        self._turn = 0

    def __enter__(self) -> "Scene":
        return self

    def __exit__(self, *_: object) -> None:
        self._shaders.close()
        self._renderer.close()

    def row(self, mode: str, seconds: float) -> dict[str, Any]:
        """All figures of one way to decode."""
        took: dict[str, list[float]] = {}
        clock: DrawClock[int] = DrawClock(self._context)
        before = self._uploaded(mode)
        num_images = self._repeat(seconds, lambda: self._image(mode, took, clock, waits=True))
        upload_kb = (self._uploaded(mode) - before) / num_images / 1e3
        row: dict[str, Any] = {"mode": mode, "upload_kb": round(upload_kb, 1)}
        row |= {
            f"{name}_ms": round(median(times) * 1e3, 3) for name, times in took.items() if times
        }
        for name, image in (
            ("draw_images_s", lambda: self._draw(mode)),
            ("images_s", lambda: self._image(mode, {}, clock, waits=False)),
        ):
            begin_s = time.perf_counter()
            num_images = self._repeat(seconds, image)
            row[name] = round(num_images / (time.perf_counter() - begin_s), 1)
        return row | self._call(mode, seconds)

    def _repeat(self, seconds: float, image: Callable[[], object]) -> int:
        """Make images for so long; how many they were."""
        end_s, count = time.perf_counter() + seconds, 0
        while time.perf_counter() < end_s or count < 12:
            image()
            count += 1
            if count % 4 == 0:  # no further ahead of the GPU than drivers let programs be
                wait_for_gpu(self._context)
        wait_for_gpu(self._context)
        return count

    def _image(
        self, mode: str, took: dict[str, list[float]], clock: DrawClock[int], *, waits: bool
    ) -> None:
        """Decode everybody, one after the other, and draw."""
        self._turn += 1
        begin_s, upload_s, decode_s = time.perf_counter(), 0.0, 0.0
        for index, decoder in enumerate(self._decoders[: len(self._avatars)]):
            latent = self._faces[index][self._turn % NUM_FACES]
            if mode == "gpu":
                self._shaders.submit(f"gpu {index}", DecodeRequest(latent, FRONT, 0))
                continue
            maps = decoder.decode(latent, FRONT)
            done_s = time.perf_counter()
            self._renderer.update_maps(f"cpu {index}", maps.position_map, maps.expression_map)
            upload_s += time.perf_counter() - done_s
        if mode == "gpu":
            decode_s = sum(result.decode_s for result in self._shaders.take_results())
        python_s = time.perf_counter() - begin_s - upload_s
        begin_s = time.perf_counter()
        with clock.around(0):
            self._draw(mode)
        times = {"decode": decode_s or python_s, "python": python_s, "upload": upload_s}
        times["submit"] = time.perf_counter() - begin_s
        if waits:
            wait_for_gpu(self._context)
        for name, value in times.items():
            took.setdefault(name, []).append(value)
        took.setdefault("draw", []).extend(drawn for _, drawn in clock.take())

    def _draw(self, mode: str) -> None:
        self._renderer.forget_frame()
        heads = [
            Placement(slot=f"{mode} {index}", world_from_head=matrix)
            for index, matrix in enumerate(self._matrices)
        ]
        self._renderer.draw(heads, *self._eyes)

    def _call(self, mode: str, seconds: float) -> dict[str, Any]:
        """As a call does it: planned, and decoded beside drawing by ONNX Runtime."""
        planner = FramePlanner(Scheduler(SchedulerOptions(mesh_px=(0.0, 0.0), full_px=0.0)))
        heads = [
            Head(slot=f"{mode} {index}", avatar=avatar, world_from_head=matrix)
            for index, (avatar, matrix) in enumerate(
                zip(self._avatars, self._matrices, strict=True)
            )
        ]
        shown = {head.slot: head for head in heads}
        begin_s, thread_s = time.perf_counter(), time.thread_time()
        num_decodes = 0
        with DecodePool(OnnxDecoder, workers=self._workers, prepares_ahead=False) as pool:
            for head in heads if mode == "cpu" else ():
                pool.add(head.slot, head.avatar)
            decoder = pool if mode == "cpu" else self._shaders

            def image() -> None:
                nonlocal num_decodes
                self._turn += 1
                now = time.perf_counter()
                for head, faces in zip(heads, self._faces, strict=True):
                    head.latent = faces[self._turn % NUM_FACES]
                planner.plan(heads, self._eyes, self._size, 1.0, now)
                for head, request in planner.requests(heads, now):
                    decoder.submit(head.slot, request)
                for result in decoder.take_results():
                    if result.maps is not None and result.maps.expression_map is not None:
                        maps = result.maps
                        self._renderer.update_maps(
                            result.slot, maps.position_map, maps.expression_map
                        )
                    planner.note_decoded(shown[result.slot], result, 0.0, now)
                    num_decodes += 1
                self._draw(mode)

            self._repeat(0.0, image)
            pool.wait_idle(20.0)
            num_decodes, begin_s, thread_s = 0, time.perf_counter(), time.thread_time()
            count = self._repeat(seconds, image)
            thread_ms = 1e3 * (time.thread_time() - thread_s) / count
            rate = count / (time.perf_counter() - begin_s)
        return {
            "call_images_s": round(rate, 1),
            "call_decodes_an_image": round(num_decodes / count, 2),
            "thread_ms": round(thread_ms, 3),
        }

    def _uploaded(self, mode: str) -> int:
        if mode == "gpu":
            return self._shaders.bytes_uploaded
        slots = (f"cpu {index}" for index in range(len(self._avatars)))
        return sum(self._renderer.bytes_uploaded(slot) for slot in slots)


if __name__ == "__main__":
    main()
