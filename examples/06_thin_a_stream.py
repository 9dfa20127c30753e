"""Thin a stream by dropping its upper temporal layers, as a relay does for a slow reader.

You learn why a relay needs no decoder: no frame depends on a frame of a higher layer, so whoever
forwards a stream may leave out layer 2, or 2 and 1, at any moment. What is left always decodes.
"""

from pica_client.sources import open_source
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar
from pica_core.avatar.shipped import shipped_avatar_files
from pica_core.avatar.streams import open_decoder, open_encoder
from pica_core.codec.latent_sample import ReceivedFrame
from pica_core.codec.latent_stream import StreamConfig

FPS, SECONDS = 30, 4
avatar = load_avatar(shipped_avatar_files()[0])
source, expressions = open_source("performance:talk"), ExpressionEncoder(avatar)
encoder, profile = open_encoder(avatar, StreamConfig(fps=FPS))

stream = []
for index in range(FPS * SECONDS):
    frame, now_us = source.frame_at(index / FPS), round(index / FPS * 1e6)
    coded = encoder.encode(
        expressions.encode(frame.arkit), frame.rotation, frame.translation_m, now_us
    )
    if coded is not None:
        stream.append((now_us, coded))

print("layers  frames/s  kbit/s  lost")
for top in (2, 1, 0):
    decoder = open_decoder(avatar, profile)
    num_sent = num_bytes = num_decoded = 0
    for number, (now_us, coded) in enumerate(stream):
        if coded.layer > top:
            continue
        num_sent += 1
        num_bytes += len(coded.payload)
        received = ReceivedFrame(number, now_us, coded.layer, coded.is_keyframe, coded.payload)
        num_decoded += len(decoder.receive(received))
    assert num_decoded == num_sent
    assert not decoder.needs_keyframe
    rate = num_bytes * 8 / SECONDS / 1000
    print(f"0 to {top}  {num_sent / SECONDS:8.1f}  {rate:6.2f}  {num_sent - num_decoded:4d}")
