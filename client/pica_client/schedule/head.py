"""One head of a call: what is seen of it, what was asked of its decoder, how it is drawn. Pure.

A head is kept from frame to frame by the code that draws it, and is forgotten with it. In each
frame its owner places it, `see_heads` finds what cameras see of it, and the scheduler chooses what
it gets.

Maps of another level, with its mesh, are shown at once: at the heights where they change a picture
differs by no more than an error (MSE) of 11, by 6 steps of 255 in all but a hundredth of the pixels
(measured on three avatars).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Literal, NamedTuple

import numpy as np

from pica_client.decode.request import DecodeRequest
from pica_client.render.scene import FAR_M, NEAR_M, Placement, view_direction
from pica_client.schedule.visibility import NOTHING, Sight, look
from pica_core.avatar.file import Avatar
from pica_core.camera import Camera
from pica_core.types import LATENT_SHAPE, FloatArray

Decode = Literal["none", "expression", "both"]

UNLIKE = 1e3
"""Change of a latent that nothing can be compared with."""


class Choice(NamedTuple):
    """What one head gets in a frame."""

    level: int
    """Level of the maps, and of the mesh, that are drawn once this frame's decode is there."""
    decode: Decode
    """What to decode now, at `level`; "expression" with the latent of the maps that are there."""
    scale: float
    """Share of the image's resolution that it is drawn with."""
    every: int
    """Which frames of its stream to ask for: 1 is all, 2 or 4 each second or fourth, 0 none."""


@dataclass(kw_only=True, slots=True, eq=False)
class Head:
    """A head with a face."""

    slot: str
    avatar: Avatar = field(repr=False)
    world_from_head: FloatArray = field(default_factory=lambda: np.eye(4, dtype=np.float32))
    """Head frame to world, float32 ``[4, 4]``."""
    latent: FloatArray = field(default_factory=lambda: np.zeros(LATENT_SHAPE, np.float32))
    """What it should show. float32 ``[8, 8, 4]``."""
    captured_us: int = 0
    """Sender's clock at the newest sample in the latent; handed through to the decode."""
    is_listening: bool = False
    """Whether others speak: its face is not looked at most."""

    sight: Sight = NOTHING
    """What can be seen of it in the planned frame."""
    view_direction: FloatArray = field(default_factory=lambda: np.array([0, 0, 1], np.float32))
    """Camera centre seen from the head, unit length, head frame. float32 ``[3]``."""
    latent_change: float = 0.0
    """Root mean square over the 256 numbers, between the latent of now and that of its maps."""
    view_turn_rad: float = 0.0
    """How far the view has turned since its expression map was asked for."""
    seen_s: float | None = None
    """When it was last to be seen, or first planned; None before that."""
    choice: Choice | None = None

    asked: DecodeRequest | None = None
    """The decode that was asked for last."""
    asked_s: float = -math.inf
    """When that was."""
    latent_asked_s: float = -math.inf
    """When its latent was first asked for; a decode of the expression map alone keeps it."""

    num_triangles: tuple[int, ...] = field(init=False)
    """Triangles of each level's mesh."""
    model: str = field(init=False)
    """What its costs are named in the cost model."""

    def __post_init__(self) -> None:
        avatar = self.avatar
        self.num_triangles = tuple(len(avatar.level_faces(level)) for level in avatar.levels)
        self.model = f"{avatar.spec.geometry} {avatar.spec.block}"

    @property
    def held_level(self) -> int | None:
        """Level of the maps that were asked for last; None before the first."""
        return None if self.asked is None else self.asked.level

    def measure_motion(self) -> None:
        """Find how far its latent and its view have moved since what was asked for. A latent of a
        wrong shape has moved far: the decoder is to refuse it."""
        self.latent_change, self.view_turn_rad = 0.0, 0.0
        if self.asked is None:
            return
        if self.latent.shape == self.asked.latent.shape:
            moved = (self.latent - self.asked.latent).ravel()
            self.latent_change = math.sqrt(float(moved.dot(moved)) / moved.size)
        else:
            self.latent_change = UNLIKE
        cosine = float(self.view_direction.dot(self.asked.view_direction))
        self.view_turn_rad = math.acos(min(max(cosine, -1.0), 1.0))

    def request(self, now: float) -> DecodeRequest | None:
        """What its choice decodes, None for nothing; it counts as asked for."""
        choice = self.choice
        if choice is None or choice.decode == "none":
            return None
        latent, captured_us = self.latent, self.captured_us
        if choice.decode == "expression" and self.asked is not None:
            # The position map stays: both must be of the same face.
            latent = self.asked.latent
            if not np.array_equal(latent, self.latent):  # a face at rest is as new as its sample
                captured_us = self.asked.captured_us
        else:
            self.latent_asked_s = now
        view = self.view_direction
        self.asked = DecodeRequest(latent, view, captured_us, choice.level, choice.decode)
        self.asked_s = now
        return self.asked

    def dressed(self, placement: Placement) -> Placement:
        """Its placement as it is to be drawn: its share of the resolution."""
        return placement if self.choice is None else replace(placement, scale=self.choice.scale)


def see_heads(heads: Sequence[Head], cameras: Sequence[Camera], size_px: tuple[int, int]) -> None:
    """Tell each head what cameras see of it and how far it has moved; two eyes see it from between
    them.

    Args:
        cameras: One, or both eyes'.
        size_px: Columns and rows of one eye's image.
    """
    if not heads:
        return
    matrices = np.array([head.world_from_head for head in heads], np.float64)
    boxes = [head.avatar.manifest for head in heads]
    low_m, high_m = [box.bounds_min_m for box in boxes], [box.bounds_max_m for box in boxes]
    eyes = [
        look(np.matmul(camera.clip_from_world(NEAR_M, FAR_M), matrices), low_m, high_m, size_px)
        for camera in cameras
    ]
    middle_m = np.mean([camera.centre_m for camera in cameras], axis=0)
    for head, *sights in zip(heads, *eyes, strict=True):
        head.sight = reduce(Sight.with_eye, sights)
        head.view_direction = view_direction(head.world_from_head, middle_m)
        head.measure_motion()
