"""The shape of a latent, which everything else agrees on: what is coded, sent and decoded.

Ma et al., "Pixel Codec Avatars", CVPR 2021, section 3.
"""

LATENT_SIZE = 8
LATENT_CHANNELS = 4
LATENT_SHAPE = (LATENT_SIZE, LATENT_SIZE, LATENT_CHANNELS)
"""Rows, columns, channels of Z. Channel-last, as on the wire."""
NUM_LATENT = LATENT_SIZE * LATENT_SIZE * LATENT_CHANNELS
