"""The playout policies that benches compare."""

from dataclasses import replace

from pica_client.playout.config import PlayoutConfig

ADAPTIVE = PlayoutConfig()
"""What receivers use."""
FIXED = replace(ADAPTIVE, floor_s=0.1, floor_intervals=0.0, ceiling_s=0.1)
"""Always 100 ms behind the fastest frame; moves and conceals as ADAPTIVE does."""
UNBUFFERED = replace(
    ADAPTIVE,
    floor_s=0.0,
    floor_intervals=0.0,
    ceiling_s=0.0,
    leap_s=0.0,
    extrapolate_s=0.0,
    blend_s=0.0,
)
"""Each frame is shown when it comes, unless a newer one is shown already."""
POLICIES = {"adaptive": ADAPTIVE, "fixed": FIXED, "unbuffered": UNBUFFERED}
