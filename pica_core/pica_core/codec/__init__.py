"""The latent stream: faces in, a few bytes a frame out, and back. Integers only."""
