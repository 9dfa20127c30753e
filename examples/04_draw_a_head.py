"""Draw two heads with moderngl, step by step.

You learn what happens between a latent and a pixel. ONNX Runtime makes two maps per frame and
person: where each texel of the face is, and a code of what it looks like. The renderer hands
them to shaders; the fragment shader runs the pixel decoder for each pixel that is seen.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from pica_client.decode.decoder import OnnxDecoder
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import (
    Placement,
    head_matrix,
    view_direction,
)
from pica_client.render.seats import plan_seats
from pica_client.render.views import ViewState, plan_camera
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar, shipped_avatar_files
from pica_core.gl import create_context

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
OUT.mkdir(parents=True, exist_ok=True)
SIZE = (640, 360)

talking = np.zeros(NUM_ARKIT, np.float32)
talking[ARKIT_INDEX["jawOpen"]] = 0.5
files = shipped_avatar_files()[:2]
plan = plan_seats("line", len(files), SIZE[0] / SIZE[1])
camera = plan_camera(plan, ViewState(), *SIZE)

context = create_context()
renderer = Renderer(context, SIZE, RenderOptions(fade_busts=True))
placements = []
for file, seat in zip(files, plan.seats, strict=True):
    avatar = load_avatar(file)
    world_from_head = head_matrix(seat, np.zeros(3), np.zeros(3))
    towards_camera = view_direction(world_from_head, camera.centre_m)
    latent = ExpressionEncoder(avatar).encode(talking)
    maps = OnnxDecoder(avatar).decode(latent, towards_camera)
    print(f"{avatar.manifest.name}: maps of {maps.level} texels a side")
    renderer.add_avatar(file.stem, avatar)
    renderer.update_maps(file.stem, maps.position_map, maps.expression_map)
    placements.append(Placement(slot=file.stem, world_from_head=world_from_head))
renderer.draw(placements, camera)
Image.fromarray(renderer.read_image()).save(OUT / "two-heads.png")
print(f"drawn by {context.info['GL_RENDERER']}")
context.release()
