"""Decode an avatar and draw it into PNG files: at rest, and with a smile.

You learn that an expression is 52 ARKit values, in a fixed order and found by name, and the way
from there: expression, latent, position and expression maps, pixels. It needs no display.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from pica_client.decode.decoder import OnnxDecoder
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, head_matrix, view_direction
from pica_client.render.seats import plan_seats
from pica_client.render.views import ViewState, plan_camera
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar, shipped_avatar_files
from pica_core.gl import create_context

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
OUT.mkdir(parents=True, exist_ok=True)
SIZE = (384, 384)

avatar = load_avatar(shipped_avatar_files()[0])
encoder, decoder = ExpressionEncoder(avatar), OnnxDecoder(avatar)
rest, smile = np.zeros(NUM_ARKIT, np.float32), np.zeros(NUM_ARKIT, np.float32)
for name in ("mouthSmileLeft", "mouthSmileRight", "cheekSquintLeft", "cheekSquintRight"):
    smile[ARKIT_INDEX[name]] = 0.9

seats = plan_seats("grid", 1, SIZE[0] / SIZE[1])
camera = plan_camera(seats, ViewState(), *SIZE)
place = head_matrix(seats.seats[0], np.zeros(3), np.zeros(3))

renderer = Renderer(create_context(), SIZE, RenderOptions(fade_busts=True))
renderer.add_avatar("avatar", avatar)
for name, expression in (("rest", rest), ("smile", smile)):
    maps = decoder.decode(encoder.encode(expression), view_direction(place, camera.centre_m))
    renderer.update_maps("avatar", maps.position_map, maps.expression_map)
    renderer.draw([Placement(slot="avatar", world_from_head=place)], camera)
    image = renderer.read_image()
    Image.fromarray(image).save(OUT / f"{avatar.manifest.name.lower()}-{name}.png")
    print(f"{avatar.manifest.name}, {name}: mean colour {image.mean(axis=(0, 1)).round(1)}")
