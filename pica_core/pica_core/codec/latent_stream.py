"""The latent stream: faces in, a few bytes a frame out, and back.

    encoder = LatentEncoder(profile, StreamConfig(fps=30))
    frame = encoder.encode(latent, rotation, translation_m, now_us)      # None: nothing to say
    decoder = LatentDecoder(profile)
    received = ReceivedFrame(number, captured_us, frame.layer, frame.is_keyframe, frame.payload)
    decoder.receive(received)

Theory of operation. Frames stand in *temporal layers*: with three, every fourth frame is base (0),
the one between two of those is layer 1, the rest are layer 2. A base frame refers to the base frame
before it, a frame of layer 1 to the last base frame, one of layer 2 to the last frame of a lower
layer. So whoever forwards a stream may leave out layer 2, or 2 and 1, at any moment, and let them
in again at any moment: nothing that is left depends on what is gone. A keyframe refers to nothing;
it comes first, when somebody asks, and every few seconds.

A face that does not change falls silent: one last base frame says so and is a little finer than the
rest (it will be looked at for long), then a heartbeat once a second keeps the stream alive, until
something moves by more than the dead zone.

Every frame says how many frames back its reference is, so a decoder knows whether it has that very
frame. It never guesses: a frame whose reference is not there waits for it (frames may overtake each
other), and when it does not come the decoder says so and a keyframe heals everything. It cannot
show a corrupt face: a payload is decoded whole, against the right reference, or not at all.

Coding of one frame: `frames`; tables: `profile`; bytes: docs/bitstream.md.
"""

from pica_core.codec.latent_decoder import LatentDecoder
from pica_core.codec.latent_encoder import DEFAULT_QUALITY, LatentEncoder, StreamConfig

__all__ = ["DEFAULT_QUALITY", "LatentDecoder", "LatentEncoder", "StreamConfig"]
