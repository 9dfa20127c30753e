"""Which parameters a phase trains, and how fast."""

import math

import torch
from torch import nn

from pica_core.model.interface import AvatarModel
from pica_core.train.config import ScheduleConfig

WARMUP_RATIO = 0.02
"""Part of a phase in which the learning rate rises linearly."""
FINAL_RATE_RATIO = 0.02
"""Learning rate at the end of a phase, against its peak; between them half a cosine."""
LIVE_RATE_RATIO = 0.5
"""Rates on pictures of poses, when all is learned but for what they add, against the joint ones."""


def make_optimiser(model: AvatarModel, schedule: ScheduleConfig, phase: str) -> torch.optim.Adam:
    """Adam over the parameters of a phase, one of `PHASES` or "live", a driver phase with pictures
    of poses; each group keeps its peak rate as ``"peak"``."""
    of = model.parameter_groups()
    match phase:
        case "geometry":
            groups = [(of["shape"], schedule.geometry_rate)]
        case "joint" | "live":
            groups = [
                ([*of["shape"], *of["appearance"]], schedule.joint_rate),
                (of["pixel"], schedule.pixel_rate),
                (of["encoding"], schedule.encoding_rate),
            ]
            if phase == "live":
                last = model.expression_encoder.layers[-1].parameters()
                groups = [(params, LIVE_RATE_RATIO * rate) for params, rate in groups]
                groups.append((list(last), schedule.driver_rate))
        case _:
            groups = [(list(model.expression_encoder.parameters()), schedule.driver_rate)]
    return torch.optim.Adam(
        [{"params": params, "lr": rate, "peak": rate} for params, rate in groups if params],
        fused=True,
    )


def clip_groups(optimiser: torch.optim.Optimizer, norm: float) -> None:
    """Limit the gradient's norm in each group; the groups' losses differ in scale by thousands."""
    if norm > 0:
        for group in optimiser.param_groups:
            nn.utils.clip_grad_norm_(group["params"], norm)


def rate_ratio(index: int, length: int) -> float:
    """Learning rate of a phase's step against its peak: linear warm-up, then half a cosine."""
    warm = min(1.0, (index + 1) / max(1.0, WARMUP_RATIO * length))
    cosine = 0.5 + 0.5 * math.cos(math.pi * index / max(1, length))
    return warm * (FINAL_RATE_RATIO + (1 - FINAL_RATE_RATIO) * cosine)
