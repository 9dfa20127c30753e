"""The numbers of a training run, and the presets that ship with them.

What the paper gives stands as its section 5 and appendix A have it in the preset ``paper``. What
the presets share is a constant beside its use, in `objectives` and `train`.
"""

from dataclasses import dataclass, replace
from typing import Literal

from pica_core.avatar.spec import AvatarSpec
from pica_core.model.avatar import make_model
from pica_core.model.interface import AvatarModel, FacePrior, ModelOptions

MeshSource = Literal["truth", "tracked"]


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainConfig(ModelOptions):
    """A whole run."""

    variant: str = "full"
    """Which model of the paper's tables (`VARIANTS`)."""
    block: str = "G"
    """Block of the per-object decoders; H2 in the paper."""
    uv_encoding_size: int = 512
    """Rows and columns of m_uv; 1024 in the paper, for images of 2048 x 1334."""
    axis_encoding_size: int = 10_000
    """Entries of m_u and of m_v."""
    mesh_source: MeshSource = "truth"
    """Meshes for encoder and mesh loss: "truth", the exact ones of synthetic captures, mouth and
    eyes weighted up; or "tracked", the tracker's, the mouth masked out (as the paper). A capture
    without exact meshes has tracked ones only."""

    depth: float = 0.0
    """Weight of the depth loss."""
    normal: float = 0.0
    """Weight of the normal loss."""
    smooth: float = 0.0
    """Weight of smoothness."""
    chroma: float = 4.0
    """How much more differences of hue and saturation count than those of brightness in the image
    loss (paper 0): a face is nearly of one hue, and its lips and tongue are what is missed."""
    region_weight: float = 4.0
    """Importance of a vertex at mouth or eyes in the mesh loss, against 1 elsewhere (paper 1); also
    how much more often a pixel there is drawn."""
    lid_weight: float = 16.0
    """The same for lid vertices in the mesh loss: few, thin, and what makes a blink."""

    geometry_steps: int = 2400
    """Steps on tracked meshes alone."""
    joint_steps: int = 1500
    """Steps on images, meshes and KL, as in the paper."""
    driver_steps: int = 1000
    """Steps of the expression encoder."""
    live_steps: int = 1200
    """Joint steps that are done after the expression encoder's regression, three of four on
    pictures of poses; of models with bases, on captures that have such pictures."""
    joint_batch: int = 2
    """Images per step of the joint phase."""
    pixels_per_image: int = 8192
    """Covered pixels drawn from each image; 0 takes all, as the paper does."""
    frame_balance: float = 1.0
    """How much more often frames are drawn whose eyes or mouth lie far from their mean: 1 in
    proportion to that distance, 0 all frames alike (as the paper). A blink is a few frames of
    hundreds; drawn like the others it is not learned."""
    joint_rate: float = 3e-3
    """Peak learning rate of encoder and decoders in the joint phase."""
    pixel_rate: float = 4e-3
    """Peak learning rate of the two small sine networks."""
    encoding_rate: float = 5e-2
    """Peak learning rate of the encoding maps, whose texels each see few pixels."""
    constant_rate: bool = False
    """Keep learning rates at their peaks, as the paper; else they rise and fall in each phase."""
    clip_norm: float = 1.0
    """Limit of the gradient's norm in each group of parameters; 0 for none, as the paper."""

    seed: int = 0
    """Seed of initial weights, batches and noise."""
    checkpoint_every: int = 500
    """Steps between checkpoints."""

    def build(self, prior: FacePrior) -> AvatarModel:
        """A model with fresh weights, for the person that the prior describes."""
        spec = AvatarSpec(
            block=self.block,
            uv_encoding_size=self.uv_encoding_size,
            axis_encoding_size=self.axis_encoding_size,
        )
        return make_model(self.variant, spec, prior, self)


SMALL = TrainConfig()
PAPER = TrainConfig(
    block="H2",
    encoder="paper",
    uv_encoding_size=1024,
    encoding_amplitude=1.0,
    texture_contrast=0.0,
    texture_size=1024,
    mesh_source="tracked",
    depth=10.0,
    normal=1.0,
    smooth=1.0,
    chroma=0.0,
    region_weight=1.0,
    lid_weight=1.0,
    geometry_steps=0,
    joint_steps=400_000,
    joint_batch=4,
    pixels_per_image=0,
    frame_balance=0.0,
    joint_rate=1e-3,
    pixel_rate=1e-3,
    encoding_rate=1e-3,
    constant_rate=True,
    clip_norm=0.0,
    checkpoint_every=2000,
)
PRESETS: dict[str, TrainConfig] = {
    "tiny": replace(
        SMALL,
        uv_encoding_size=64,
        axis_encoding_size=256,
        texture_size=128,
        geometry_steps=60,
        joint_steps=60,
        driver_steps=60,
        live_steps=30,
        pixels_per_image=2048,
        checkpoint_every=50,
    ),
    "small": SMALL,
    "own": replace(SMALL, joint_steps=2400, live_steps=1800),
    "long": replace(
        SMALL, geometry_steps=4800, joint_steps=6000, driver_steps=2000, live_steps=5200
    ),
    "paper": PAPER,
}
"""tiny: `small` in seconds, for tests. small: minutes on two cores. own: half as much again, for
heads from scans and photos. long: two to four times the steps of `small`. paper: the paper's
settings to the letter (section 5, appendix A): days on a GPU; only the driver phase is ours."""
