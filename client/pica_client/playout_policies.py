"""The playout policies that `pica bench playout` compares, by the name in its rows."""

from __future__ import annotations

from typing import Final

from pica_client.playout import PlayoutConfig

FIXED_DELAY_S: Final = 0.1

POLICIES: Final[dict[str, PlayoutConfig]] = {
    "adaptive": PlayoutConfig(),
    "fixed-100": PlayoutConfig(floor_s=FIXED_DELAY_S, ceiling_s=FIXED_DELAY_S),
    "none": PlayoutConfig(floor_s=0.0, ceiling_s=0.0),
}
"""Ours; a buffer of 100 ms that neither grows nor shrinks; every frame as soon as it comes."""
