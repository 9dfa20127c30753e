"""A toy avatar whose vertices come from bases, made without training anything."""

from __future__ import annotations

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import AvatarSpec


def make_linear_avatar(grid: int = 40) -> Avatar:
    """A grid of vertices, in regions of falling rank."""
    spec = AvatarSpec(uv_encoding_size=16, axis_encoding_size=20)
    return with_toy_levels(make_toy_avatar(spec=spec, grid=grid))
