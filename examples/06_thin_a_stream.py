"""Thin a stream to a half or a quarter of its frames, as a relay does for a slow reader.

You learn why a relay needs no decoder: every frame is decoded alone, so any frame may be left out
at any moment. A receiver asks for the frames whose sequence number is a multiple of 2 or 4.
"""

from pica_client.sources import open_source
from pica_core.avatar.file import load_avatar, shipped_avatar_files
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder

FPS, SECONDS = 30, 4
avatar = load_avatar(shipped_avatar_files()[0])
source = open_source("performance:talk")
encoder = LatentEncoder(fps=FPS)

stream = []
for index in range(FPS * SECONDS):
    frame, now_us = source.frame_at(index / FPS), round(index / FPS * 1e6)
    coded = encoder.encode(frame.arkit, frame.rotation, frame.translation_m, now_us)
    if coded is not None:
        stream.append(coded)

print("every  frames/s  kbit/s")
for every in (1, 2, 4):
    decoder = LatentDecoder(avatar)
    num_sent = num_bytes = sequence = 0
    for coded in stream:
        sequence += 1 + -(sequence + 1) % coded.multiple
        if sequence % every:
            continue
        num_sent += 1
        num_bytes += len(coded.payload)
        assert decoder.decode(coded.payload).latent.shape == (8, 8, 4)
    rate = num_bytes * 8 / SECONDS / 1000
    print(f"{every:5d}  {num_sent / SECONDS:8.1f}  {rate:6.2f}")
