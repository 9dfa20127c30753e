"""A voice: Opus packets, the track beside the face, and the way to the loudspeakers."""
