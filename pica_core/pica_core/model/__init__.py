"""The Pixel Codec Avatar in torch: encoder, per-object decoders, pixel decoder."""
