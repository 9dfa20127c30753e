"""Draw many small frames with fresh maps, read them back, and watch the memory.

    python scripts/render_soak.py --frames 20000

Prints the resident memory after a tenth of the frames, when the pools of the driver are full, and
at the end, as JSON; with ``--record`` it is appended to docs/results/render-soak.jsonl.
"""

from __future__ import annotations

import argparse
import json
import os
from typing import Any

import numpy as np
from record_result import append_result, load_now

from pica_client.bench.harness import gl_context
from pica_client.bench.head import front_camera
from pica_client.bench.relay.processes import memory_bytes
from pica_client.decode.decoder import OnnxDecoder
from pica_client.render.drawing import HEAD
from pica_client.render.renderer import Renderer
from pica_client.render.scene import Placement
from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar
from pica_core.avatar.shipped import shipped_avatar_files

SIZE = 64
AHEAD = np.array([0, 0, 1], np.float32)


def soak(frames: int) -> dict[str, Any]:
    """Draw the first shipped avatar at all its levels, in turn."""
    avatar = load_avatar(shipped_avatar_files()[0])
    latent = ExpressionEncoder(avatar).encode(np.zeros(NUM_ARKIT, np.float32))
    decoder = OnnxDecoder(avatar)
    maps = [decoder.decode(latent, AHEAD, level) for level in avatar.levels]
    samples: list[tuple[int, int]] = []
    with gl_context() as context:
        renderer = Renderer(context, (SIZE, SIZE))
        renderer.add_avatar("soak", avatar)
        for index in range(frames):
            fresh = maps[index % len(maps)]
            renderer.update_maps("soak", fresh.position_map, fresh.expression_map)
            placement = Placement(slot="soak", world_from_head=HEAD, blend=0.5 + 0.5 * (index % 2))
            camera = front_camera(avatar.manifest, 60 + index % 90, (SIZE, SIZE))
            renderer.draw([placement], camera)
            renderer.read_image()
            if index % max(frames // 50, 1) == 0:
                samples.append((index, memory_bytes(os.getpid()) or 0))
    settled = [size for index, size in samples if index >= frames / 10]
    return {
        "frames": frames,
        "resident_mb_after_a_tenth": round(settled[0] / 1e6, 2),
        "resident_mb_at_the_end": round(settled[-1] / 1e6, 2),
        "growth_bytes_a_frame": round((settled[-1] - settled[0]) / (0.9 * frames), 1),
    }


def main() -> None:
    """Read the command line, draw, print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--record", action="store_true")
    options = parser.parse_args()
    load_before = load_now()
    result = soak(options.frames)
    print(json.dumps(result))
    if options.record:
        command = f"python scripts/render_soak.py --frames {options.frames}"
        append_result("render-soak", command, result, load_before)


if __name__ == "__main__":
    main()
