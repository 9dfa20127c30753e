"""Encode a performance and count its bits, at several qualities.

You learn how to use the codec alone, without a network: a frame holds what the face does, and the
receiver makes the latent of it with the avatar file. A face that does not move costs next to
nothing.
"""

import numpy as np

from pica_client.sources import open_source
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar, shipped_avatar_files
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder

FPS, SECONDS = 30, 4
avatar = load_avatar(shipped_avatar_files()[0])
source, expressions = open_source("performance:talk"), ExpressionEncoder(avatar)
frames = [source.frame_at(index / FPS) for index in range(FPS * SECONDS)]

print("quality  kbit/s  rms error of the latent")
for quality in (0, 3, 7):
    encoder = LatentEncoder(fps=FPS, quality=quality)
    decoder = LatentDecoder(avatar)
    num_bytes, errors = 0, []
    for index, frame in enumerate(frames):
        now_us = round(index / FPS * 1e6)
        coded = encoder.encode(frame.arkit, frame.rotation, frame.translation_m, now_us)
        if coded is None:
            continue  # the face stands still, and the receiver knows
        num_bytes += len(coded.payload)
        decoded = decoder.decode(coded.payload)
        errors.append(np.square(decoded.latent - expressions.encode(frame.arkit)).mean())
    print(f"{quality:7}  {num_bytes * 8 / SECONDS / 1000:6.2f}  {np.sqrt(np.mean(errors)):.4f}")
