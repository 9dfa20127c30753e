"""Options of a training run and the presets that ship with them.

A run has three phases, in this order (reasons: `docs/training.md`):

    geometry    encoder and geometry decoder on tracked meshes alone; no rendering
    joint       everything on images, meshes and KL, as in the paper
    driver      the expression encoder (52 ARKit values to the latent) on the model's own codes;
                of models with bases: a regression, then joint steps in turn with steps on
                pictures of poses, which teach it and the decoders what other expressions show
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal

from pica_core.avatar.spec import AvatarSpec
from pica_core.avatar.variants import VARIANTS
from pica_core.errors import CheckpointError, TrainingOptionError, check_ranges
from pica_core.model.interface import AvatarModel, FacePrior
from pica_core.model.options import ModelOptions
from pica_core.model.variants import make_model

MeshSource = Literal["truth", "tracked"]
PHASES = ("geometry", "joint", "driver")


@dataclass(frozen=True, kw_only=True, slots=True)
class ModelConfig(ModelOptions):
    """What is built."""

    variant: str = "full"
    """Which model of the paper's tables (`VARIANTS`)."""
    block: str = "G"
    """Block of the per-object decoders: B, H2, C or G (docs/training.md has the reason)."""
    uv_encoding_size: int = 512
    """Rows and columns of m_uv; 1024 in the paper, for images of 2048 x 1334."""
    axis_encoding_size: int = 10_000
    """Entries of m_u and of m_v."""

    def __post_init__(self) -> None:
        if self.variant not in VARIANTS:
            raise TrainingOptionError(
                f"variant is {self.variant!r}; known are {', '.join(VARIANTS)}"
            )

    def spec(self) -> AvatarSpec:
        """The sizes as an `AvatarSpec`; `make_model` adds what the variant says."""
        return AvatarSpec(
            block=self.block,
            uv_encoding_size=self.uv_encoding_size,
            axis_encoding_size=self.axis_encoding_size,
        )

    def build(self, prior: FacePrior) -> AvatarModel:
        """A model with fresh weights, for the person that the prior describes."""
        return make_model(self.variant, self.spec(), prior, self)


@dataclass(frozen=True, kw_only=True, slots=True)
class LossConfig:
    """Weights of the losses; units stand in `pica_core.train.losses`."""

    image: float = 2.0
    """Weight of the image loss (paper 2)."""
    depth: float = 0.0
    """Weight of the depth loss (paper 10)."""
    normal: float = 0.0
    """Weight of the normal loss (paper 1)."""
    mesh: float = 0.1
    """Weight of the mesh loss (paper 0.1)."""
    chroma: float = 4.0
    """How much more differences of hue and saturation count than those of brightness in the image
    loss (paper 0): a face is nearly of one hue, and its lips and tongue are what is missed."""
    smooth: float = 0.0
    """Weight of smoothness (paper 1)."""
    kl: float = 0.001
    """Weight of the KL divergence (paper 0.001)."""
    region_weight: float = 4.0
    """Importance of a vertex at mouth or eyes in the mesh loss, against 1 elsewhere; also how much
    more often a pixel there is drawn."""
    lid_weight: float = 16.0
    """The same for lid vertices in the mesh loss: few, thin, and what makes a blink."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ScheduleConfig:
    """How long and how fast."""

    frame_balance: float = 1.0
    """How much more often frames are drawn whose eyes or mouth lie far from their mean: 1 in
    proportion to that distance, 0 all frames alike (as the paper). A blink is a few frames of
    hundreds; drawn like the others it is not learned."""
    geometry_steps: int = 2400
    """Steps of the geometry phase."""
    joint_steps: int = 1500
    """Steps of the joint phase."""
    driver_steps: int = 1000
    """Steps of the driver phase."""
    live_steps: int = 1200
    """Steps of the joint phase that are done after the regression, three of four on pictures of
    poses; of models with bases, on captures that have such pictures."""
    geometry_batch: int = 2
    """Frames per step of the geometry phase: small batches and many steps learn fastest."""
    joint_batch: int = 2
    """Images per step of the joint phase (paper 4)."""
    driver_batch: int = 32
    """Frames per step of the driver phase."""
    live_batch: int = 4
    """Pictures of poses per step, with half of `pixels_per_image` each."""
    pixels_per_image: int = 8192
    """Covered pixels drawn from each image; 0 takes all, as the paper does."""
    geometry_rate: float = 4e-3
    """Peak learning rate of the geometry phase."""
    joint_rate: float = 3e-3
    """Peak learning rate of encoder and decoders in the joint phase (paper 1e-3)."""
    pixel_rate: float = 4e-3
    """Peak learning rate of the two small sine networks."""
    encoding_rate: float = 5e-2
    """Peak learning rate of the encoding maps, whose texels each see few pixels."""
    driver_rate: float = 2e-3
    """Peak learning rate of the driver phase."""
    constant_rate: bool = False
    """Keep learning rates at their peaks, as the paper; else they rise and fall in each phase."""
    clip_norm: float = 1.0
    """Limit of the gradient's norm in each group of parameters; 0 for none, as the paper."""

    @property
    def steps(self) -> tuple[int, int, int]:
        """Steps of each phase, in the order of `PHASES`."""
        return self.geometry_steps, self.joint_steps, self.driver_steps


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainConfig:
    """A whole run."""

    model: ModelConfig = field(default_factory=ModelConfig)
    losses: LossConfig = field(default_factory=LossConfig)
    schedule: ScheduleConfig = field(default_factory=ScheduleConfig)
    mesh_source: MeshSource = "truth"
    """Meshes for encoder and mesh loss: "truth", the exact ones of synthetic captures, mouth and
    eyes weighted up; or "tracked", the tracker's, the mouth masked out (as the paper). A capture
    without exact meshes has tracked ones only."""
    seed: int = 0
    """Seed of initial weights, batches and noise."""
    checkpoint_every: int = 500
    """Steps between checkpoints."""

    def __post_init__(self) -> None:
        many, any_size = (1, math.inf), (0, math.inf)
        schedule = self.schedule
        check_ranges(
            schedule,
            TrainingOptionError,
            frame_balance=(0, 2),
            **{f"{kind}_steps": any_size for kind in (*PHASES, "live")},
            **{f"{kind}_batch": many for kind in (*PHASES, "live")},
            pixels_per_image=any_size,
            clip_norm=(0, math.inf),
        )
        if self.mesh_source not in ("truth", "tracked"):
            raise TrainingOptionError(
                f"mesh_source is {self.mesh_source!r}; 'truth' and 'tracked' are known"
            )
        check_ranges(
            self,
            TrainingOptionError,
            checkpoint_every=many,
            seed=(0, (1 << 31) - 1),
        )

    def changed(
        self,
        model: Mapping[str, Any] = MappingProxyType({}),
        losses: Mapping[str, float] = MappingProxyType({}),
        schedule: Mapping[str, Any] = MappingProxyType({}),
    ) -> TrainConfig:
        """A copy whose parts have other values, by name of their fields."""
        return replace(
            self,
            model=replace(self.model, **model),
            losses=replace(self.losses, **losses),
            schedule=replace(self.schedule, **schedule),
        )

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values; `from_json` reads them back."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> TrainConfig:
        """Read what `to_json` wrote.

        Raises:
            CheckpointError: A part or a field that this version does not know.
        """
        try:
            parts = {
                "model": ModelConfig(**values["model"]),
                "losses": LossConfig(**values["losses"]),
                "schedule": ScheduleConfig(**values["schedule"]),
            }
            return cls(**{**values, **parts})
        except (KeyError, TypeError) as error:
            raise CheckpointError(f"options of another version: {error}") from error


PAPER_LOSSES = LossConfig(
    chroma=0.0, depth=10.0, normal=1.0, smooth=1.0, region_weight=1.0, lid_weight=1.0
)
"""The paper's weights (section 5 and appendix A.2), no region above another."""

PRESETS: dict[str, TrainConfig] = {
    "tiny": TrainConfig(checkpoint_every=50).changed(
        model={"uv_encoding_size": 64, "axis_encoding_size": 256, "texture_size": 128},
        schedule={
            **dict.fromkeys(("geometry_steps", "joint_steps", "driver_steps"), 60),
            "live_steps": 30,
            "geometry_batch": 4,
            "pixels_per_image": 2048,
        },
    ),
    "small": TrainConfig(),
    "long": TrainConfig().changed(
        schedule={
            "geometry_steps": 4800,
            "joint_steps": 6000,
            "driver_steps": 2000,
            "live_steps": 5200,
        }
    ),
    "paper": TrainConfig(
        model=ModelConfig(
            block="H2",
            encoder="paper",
            uv_encoding_size=1024,
            encoding_amplitude=1.0,
            texture_contrast=0.0,
            texture_size=1024,
        ),
        losses=PAPER_LOSSES,
        schedule=ScheduleConfig(
            frame_balance=0.0,
            geometry_steps=0,
            joint_steps=400_000,
            joint_batch=4,
            pixels_per_image=0,
            joint_rate=1e-3,
            pixel_rate=1e-3,
            encoding_rate=1e-3,
            constant_rate=True,
            clip_norm=0.0,
        ),
        mesh_source="tracked",
        checkpoint_every=2000,
    ),
}
"""tiny: seconds, for tests. small: minutes on two cores. long: two or three times that. paper: the
paper's settings to the letter (section 5, appendix A): days on a GPU; only the driver phase is
ours."""
