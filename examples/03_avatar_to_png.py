"""Decode an avatar and draw it into PNG files: at rest, and with a smile.

You learn that an expression is 52 ARKit values, in a fixed order and found by name.
`draw_thumbnail` goes all the way: expression, latent, position and expression maps, pixels. It
needs no display.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from pica_client.render.thumbnail import draw_thumbnail
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.file import load_avatar
from pica_core.avatar.shipped import shipped_avatar_files

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
OUT.mkdir(parents=True, exist_ok=True)

avatar = load_avatar(shipped_avatar_files()[0])
smile = np.zeros(NUM_ARKIT, np.float32)
for name in ("mouthSmileLeft", "mouthSmileRight", "cheekSquintLeft", "cheekSquintRight"):
    smile[ARKIT_INDEX[name]] = 0.9

for name, expression in (("rest", None), ("smile", smile)):
    image = draw_thumbnail(avatar, (384, 384), arkit=expression)
    Image.fromarray(image).save(OUT / f"{avatar.manifest.name.lower()}-{name}.png")
    print(f"{avatar.manifest.name}, {name}: mean colour {image.mean(axis=(0, 1)).round(1)}")
