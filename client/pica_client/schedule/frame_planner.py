"""Between the scene and the scheduler: what each head looks like now, and what its plan asks for.

    planner = FramePlanner(Scheduler())
    plan = planner.plan(heads, cameras, size_px, budget_s, now)
    for head, request in planner.requests(heads, now): pool.submit(head.slot, request)
    ...
    planner.note_decoded(head, result, upload_s, now)   # what it cost; its maps are shown now
    placement = head.dressed(placement, now)            # its mesh, how far it blends
    planner.scheduler.costs.observe_draw(num_triangles, plan.shaded_px, draw_s)

The scheduler knows numbers; this knows matrices and latents. Pure: no GPU, no clock, no threads.
"""

import math
from collections.abc import Sequence

import numpy as np

from pica_client.decode.request import DecodeRequest, DecodeResult
from pica_client.render.scene import FAR_M, NEAR_M
from pica_client.schedule.head import Head
from pica_client.schedule.scheduler import Plan, Scheduler
from pica_client.schedule.visibility import PlacedHead, look, merge_eyes
from pica_core.camera import Camera
from pica_core.latent import LATENT_SHAPE

UNLIKE = 1e3
"""Change of a latent that nothing can be compared with."""


class FramePlanner:
    """Plans frames of a scene; its scheduler chooses what each head gets."""

    def __init__(self, scheduler: Scheduler) -> None:
        self.scheduler = scheduler

    def plan(
        self,
        heads: Sequence[Head],
        cameras: Sequence[Camera],
        size_px: tuple[int, int],
        budget_s: float,
        now: float,
    ) -> Plan:
        """Choose what everybody gets in the frame that begins now.

        Args:
            heads: Everybody who has a face, in any order.
            cameras: One, or both eyes'.
            size_px: Columns and rows of one eye's image.
            budget_s: For decoding, uploads and drawing, seconds.
        """
        if heads:
            _look(heads, cameras, size_px)
            _measure_motion(heads)
        return self.scheduler.plan(heads, budget_s, now)

    def requests(self, heads: Sequence[Head], now: float) -> list[tuple[Head, DecodeRequest]]:
        """What to decode for the planned frame, near heads first; they count as asked for."""
        nearest = sorted(heads, key=lambda head: -head.sight.head_px)
        return [(head, asked) for head in nearest if (asked := head.request(now)) is not None]

    def note_decoded(self, head: Head, result: DecodeResult, upload_s: float, now: float) -> None:
        """Learn what a decode and its upload cost; its maps are drawn from now on."""
        costs = self.scheduler.costs
        costs.observe_decode(head.model, result.level, result.parts, result.decode_s)
        costs.observe_upload(result.level, result.parts, upload_s)
        head.show(result.level, now)


def _look(heads: Sequence[Head], cameras: Sequence[Camera], size_px: tuple[int, int]) -> None:
    """See what each head shows, and from where it is seen: by both eyes from between them."""
    # All heads at once: numpy takes as long for one as for five.
    matrices = np.array([head.world_from_head for head in heads], np.float64)
    boxes = [
        (head.avatar.manifest.bounds_min_m, head.avatar.manifest.bounds_max_m) for head in heads
    ]
    eyes = []
    for camera in cameras:
        clip = np.matmul(camera.clip_from_world(NEAR_M, FAR_M), matrices)
        placed = [PlacedHead(matrix, *box) for matrix, box in zip(clip, boxes, strict=True)]
        eyes.append(look(placed, size_px))
    middle = np.mean([camera.centre_m for camera in cameras], axis=0)
    towards = middle - matrices[:, :3, 3]
    seen = np.matmul(towards[:, None, :], matrices[:, :3, :3])[:, 0]
    lengths = np.linalg.norm(seen, axis=1, keepdims=True)
    ahead = np.array([0.0, 0.0, 1.0])
    views = np.where(lengths < 1e-9, ahead, seen / np.maximum(lengths, 1e-9)).astype(np.float32)
    for head, sight, view in zip(heads, merge_eyes(eyes), views, strict=True):
        head.sight, head.view_direction = sight, view


def _measure_motion(heads: Sequence[Head]) -> None:
    """Say how far each head's latent and view have moved since what was asked for. A latent of a
    wrong shape has moved far: the decoder is to refuse it."""
    known = []
    for head in heads:
        is_sound = head.latent.shape == LATENT_SHAPE
        head.latent_change, head.view_turn_rad = 0.0 if is_sound else UNLIKE, 0.0
        if head.asked is not None and head.asked.latent.shape == head.latent.shape == LATENT_SHAPE:
            known.append((head, head.asked))
    if not known:
        return
    count = len(known)
    now = np.array([head.latent for head, _ in known]).reshape(count, -1)
    then = np.array([asked.latent for _, asked in known]).reshape(count, -1)
    changes = np.sqrt(np.square(now - then).mean(axis=1)).tolist()
    seen_now = np.array([head.view_direction for head, _ in known])
    seen_then = np.array([asked.view_direction for _, asked in known])
    cosines = (seen_now * seen_then).sum(axis=1).tolist()
    for (head, _), change, cosine in zip(known, changes, cosines, strict=True):
        head.latent_change = change
        head.view_turn_rad = math.acos(min(max(cosine, -1.0), 1.0))
