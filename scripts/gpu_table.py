"""Measure decoding by ONNX Runtime and in shaders in turns, with one JSON line for each case.

    PYTHONPATH=client:pica_core:protocol python scripts/gpu_table.py              two minutes
    PYTHONPATH=client:pica_core:protocol python scripts/gpu_table.py --quick      small images

Every head is its own person, changes in every image and is drawn whole, as in a call. In
milliseconds an image with all heads decoded again: ``decode`` by ONNX Runtime on one thread (a call
has several) or in shaders by the GPU's clock, ``draw`` by that clock; and of this thread ``python``
to submit decodes, ``upload`` of maps, ``submit`` of the drawing, ``thread`` all processor time. The
first lines are the largest differences from numpy. Needs moderngl, numpy, safetensors, onnx,
onnxruntime and platformdirs.
"""

import argparse
import json
import os
import time
from collections import defaultdict
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np

from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool, num_workers
from pica_client.decode.request import DecodeRequest
from pica_client.render.draw_clock import DrawClock
from pica_client.render.gpu_decoder import GpuDecoder
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
FRONT = np.array([0, 0, 1], np.float32)
ROUNDS, NUM_FACES, LEAST_IMAGES = 2, 8, 12
AHEAD = 4  # images that are submitted before the GPU is waited for


def print_line(**values: Any) -> None:
    """Print one JSON line, at once."""
    print(json.dumps(values), flush=True)


def faces_of(avatar: Avatar, count: int) -> list[FloatArray]:
    """Latents of a face that moves."""
    rng, encoder = np.random.default_rng(5), ExpressionEncoder(avatar)
    return [encoder.encode(rng.uniform(0, 0.7, 52).astype(np.float32)) for _ in range(count)]


def errors(context: Any, avatar: Avatar) -> dict[str, Any]:
    """The largest difference of both maps from numpy, at each level: in shaders, and by ONNX."""
    found: dict[str, Any] = {"avatar": avatar.manifest.name}
    latent, onnx = faces_of(avatar, 1)[0], OnnxDecoder(avatar)
    with Renderer(context, (64, 64)) as renderer:
        decoder = GpuDecoder(context, renderer.show_maps)
        renderer.add_avatar("head", avatar)
        decoder.add("head", avatar)
        for level in avatar.levels:
            decoder.submit("head", DecodeRequest(latent, FRONT, 0, level))
            decoder.take_results()
            maps = onnx.decode(latent, FRONT, level)
            codes = decode_expression_map(avatar, latent, FRONT, level)
            wanted = decode_position_map(avatar, latent, level), codes
            for name, made in (
                ("gpu", renderer.read_maps("head")),
                ("onnx", (maps.position_map, maps.expression_map)),
            ):
                for kind, one, true in zip(("m", "code"), made, wanted, strict=True):
                    found[f"{name}_{level}_{kind}"] = float(f"{np.abs(one - true).max():.2g}")
    return found


def repeat(context: Any, seconds: float, image: Callable[[], object]) -> int:
    """Make images for so long; how many they were."""
    end_s, count = time.perf_counter() + seconds, 0
    while time.perf_counter() < end_s or count < LEAST_IMAGES:
        image()
        count += 1
        if count % AHEAD == 0:
            wait_for_gpu(context)
    return count


class Scene:
    """Heads on a grid before one or two eyes, each of them in two slots: one a decoder."""

    def __init__(
        self, renderer: Renderer, shaders: GpuDecoder, num_eyes: int, avatars: list[Avatar]
    ) -> None:
        self._renderer, self._shaders, size = renderer, shaders, renderer.size
        self._size = (size[0] // num_eyes, size[1])
        plan = plan_seats("grid", count=len(avatars), aspect=self._size[0] / size[1])
        camera = plan_camera(plan, ViewState(), *self._size)
        self._eyes = stereo_cameras(camera, EYE_DISTANCE_M, 1.0) if num_eyes == 2 else (camera,)
        self._avatars = avatars
        self._matrices = [head_matrix(seat, [0, 0, 0], [0, 0, 0]) for seat in plan.seats]
        self._faces = [faces_of(avatar, NUM_FACES) for avatar in avatars]
        for index, avatar in enumerate(avatars):
            self._renderer.add_avatar(f"cpu {index}", avatar)
            self._renderer.add_avatar(f"gpu {index}", avatar)
            self._shaders.add(f"gpu {index}", avatar)
        self._turn = 0

    def row(self, context: Any, mode: str, seconds: float) -> dict[str, Any]:
        """All figures of one way to decode."""
        with DecodePool(OnnxDecoder, workers=num_workers(os.cpu_count())) as pool:
            heads = [
                Head(slot=f"{mode} {index}", avatar=avatar, world_from_head=self._matrices[index])
                for index, avatar in enumerate(self._avatars)
            ]
            for head in heads if mode == "cpu" else ():
                pool.add(head.slot, head.avatar)
            by_slot = {head.slot: head for head in heads}
            places = [Placement(slot=h.slot, world_from_head=h.world_from_head) for h in heads]
            decoder = self._shaders if mode == "gpu" else pool
            planner = FramePlanner(Scheduler(SchedulerOptions(mesh_px=(0.0, 0.0), full_px=0.0)))
            clock: DrawClock[str] = DrawClock(context)
            took: dict[str, list[float]] = defaultdict(list)

            def uploaded() -> int:
                maps = sum(self._renderer.bytes_uploaded(slot) for slot in by_slot)
                return maps + self._shaders.bytes_uploaded

            def image() -> None:
                self._turn += 1
                begin_s = time.perf_counter()
                for head, faces in zip(heads, self._faces, strict=True):
                    head.latent = faces[self._turn % NUM_FACES]
                planner.plan(heads, self._eyes, self._size, 1.0, begin_s)
                asked = planner.requests(heads, begin_s)
                decode_s = time.perf_counter()
                for head, request in asked:
                    decoder.submit(head.slot, request)
                results = decoder.take_results()
                took["python"].append(time.perf_counter() - decode_s)
                for result in results:
                    assert result.maps is not None, result.error
                    maps, upload_s = result.maps, time.perf_counter()
                    self._renderer.update_maps(result.slot, maps.position_map, maps.expression_map)
                    took["upload"].append(len(heads) * (time.perf_counter() - upload_s))
                    took["decode"].append(len(heads) * result.decode_s)
                    planner.note_decoded(by_slot[result.slot], result, 0.0, begin_s)
                draw_s = time.perf_counter()
                self._renderer.forget_frame()
                with clock.around(mode):
                    self._renderer.draw(places, *self._eyes)
                took["submit"].append(time.perf_counter() - draw_s)
                took["draw"] += [drawn_s for _, drawn_s in clock.take()]

            repeat(context, 0.0, image)
            pool.wait_idle(30.0)
            took.clear()
            before, begin_s, thread_s = uploaded(), time.perf_counter(), time.thread_time()
            count = repeat(context, seconds, image)
            per_s = count / (time.perf_counter() - begin_s)
            thread_ms = 1e3 * (time.thread_time() - thread_s) / count
        num_decodes = len(took["decode"])
        row: dict[str, Any] = {"mode": mode, "images_s": round(per_s, 1)}
        row["decodes_an_image"] = round(num_decodes / count, 2)
        row |= {f"{name}_ms": round(median(times) * 1e3, 3) for name, times in took.items()}
        row["thread_ms"] = round(thread_ms, 3)
        upload_kb = (uploaded() - before) * len(heads) / num_decodes / 1e3
        return {**row, "upload_kb": round(upload_kb, 1)}


def main() -> None:
    """Print all lines."""
    parser = argparse.ArgumentParser(description="Measure both ways to decode in turns.")
    parser.add_argument("--quick", action="store_true", help="small images, few of them")
    options = parser.parse_args()
    cases, seconds = (QUICK, 0.1) if options.quick else (CASES, 2.0)
    context, files = create_context(), shipped_avatar_files()
    print_line(gl_renderer=context.info["GL_RENDERER"], cores=os.cpu_count())
    most = max(count for _, _, counts in cases for count in counts)
    avatars = [load_avatar(files[index % len(files)]) for index in range(most)]
    for avatar in avatars[: 1 if options.quick else len(files)]:
        print_line(**errors(context, avatar))
    for size, num_eyes, counts in cases:
        for count in counts:
            with (
                Renderer(context, size, RenderOptions(fade_busts=True)) as drawer,
                GpuDecoder(context, drawer.show_maps) as shaders,
            ):
                scene = Scene(drawer, shaders, num_eyes, avatars[:count])
                for mode in ("cpu", "gpu") * ROUNDS:
                    case = {"size": size, "eyes": num_eyes, "heads": count}
                    print_line(**case, **scene.row(context, mode, seconds))


if __name__ == "__main__":
    main()
