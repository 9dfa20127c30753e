"""Trained models as benches run them: what `pica export` wrote, avatars and baselines alike."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import safetensors

from pica_client.bench.eval_rows import ModelKey
from pica_client.bench.head import Bounded, textured_mesh
from pica_client.decode.decoder import BaselineDecoder, OnnxDecoder, OnnxOptions
from pica_client.errors import OptionError
from pica_client.render.renderer import Renderer
from pica_core.avatar.baseline import KEY as BASELINE_KEY
from pica_core.avatar.baseline import BaselineAvatar, load_baseline
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar, load_avatar
from pica_core.avatar.variants import VARIANTS, ModelCost, pixel_codec_cost
from pica_core.types import FloatArray

BASELINE = "baseline"
"""Its row of the paper's tables."""


class Model(ABC):
    """A trained model as a receiver runs it: file, cost, where its head is, and its encoder."""

    def __init__(
        self, key: ModelKey, path: Path, cost: ModelCost, weights: Avatar | BaselineAvatar
    ) -> None:
        self.key, self.file_bytes, self.cost = key, path.stat().st_size, cost
        self.box: Bounded = weights.manifest if isinstance(weights, Avatar) else weights
        self.encoder = ExpressionEncoder(weights)

    @abstractmethod
    def stage(self, renderer: Renderer, slot: str, onnx: OnnxOptions) -> None:
        """Get ready to be decoded, and to be drawn in a slot of a renderer."""

    @abstractmethod
    def decode(self, latent: FloatArray, direction: FloatArray) -> None:
        """Decode a latent and keep what comes of it."""

    @abstractmethod
    def upload(self, renderer: Renderer, slot: str) -> None:
        """Hand the renderer, at the slot of `stage`, what was decoded last."""


class CodecModel(Model):
    """An avatar, at its full level."""

    def __init__(self, path: Path) -> None:
        avatar = self._avatar = load_avatar(path)
        key = ModelKey(avatar.manifest.identity, avatar.manifest.variant, avatar.spec.block)
        super().__init__(key, path, pixel_codec_cost(avatar.spec), avatar)

    def stage(self, renderer: Renderer, slot: str, onnx: OnnxOptions) -> None:
        """Open the decoder of both maps, and give the avatar to the renderer."""
        self._decoder = OnnxDecoder(self._avatar, onnx)
        renderer.add_avatar(slot, self._avatar)

    def decode(self, latent: FloatArray, direction: FloatArray) -> None:
        """Decode both maps."""
        self._maps = self._decoder.decode(latent, direction)

    def upload(self, renderer: Renderer, slot: str) -> None:
        """Hand both maps over."""
        renderer.update_maps(slot, self._maps.position_map, self._maps.expression_map)


class TexturedModel(Model):
    """A baseline.

    Raises:
        OptionError: Its file has no expression encoder.
    """

    def __init__(self, path: Path, identity: str) -> None:
        baseline = self._baseline = load_baseline(path)
        if "encoder.0.weight" not in baseline.tensors:
            raise OptionError(f"{path}: this baseline has no expression encoder; export it again")
        spec = baseline.spec
        cost = ModelCost(
            parameters=spec.num_parameters,
            per_object_multiply_adds=spec.multiply_adds,
            per_pixel_multiply_adds=0,
        )
        super().__init__(ModelKey(identity, BASELINE, None), path, cost, baseline)

    def stage(self, renderer: Renderer, slot: str, onnx: OnnxOptions) -> None:
        """Open the decoder of mesh and texture, and give the mesh's topology to the renderer."""
        self._decoder = BaselineDecoder(self._baseline, onnx)
        renderer.add_textured(slot, textured_mesh(self._baseline))

    def decode(self, latent: FloatArray, direction: FloatArray) -> None:
        """Decode mesh and texture."""
        self._maps = self._decoder.decode(latent, direction)

    def upload(self, renderer: Renderer, slot: str) -> None:
        """Hand mesh and texture over."""
        renderer.update_textured(slot, self._maps.vertices_m, self._maps.texture)


def open_models(names: Sequence[str]) -> list[Model]:
    """Read avatars and baselines.

    Args:
        names: Files, or folders for all ``.pica`` files in them. A baseline's file does not say
            whom it shows: that is the one person of all avatars here, or written before its name,
            ``IDENTITY=FILE``.

    Returns:
        Models by person, in the order of the paper's tables.

    Raises:
        OptionError: No files, two of the same model, or a baseline without a person.
        AvatarFileError: A file that is neither an avatar nor a baseline.
    """
    files = [found for name in names for found in _files(name)]
    avatars = [(CodecModel(path), path, who) for path, who in files if not _is_baseline(path)]
    for model, path, identity in avatars:
        if identity not in (None, model.key.identity):
            raise OptionError(f"{path}: shows {model.key.identity}, not {identity}")
    people = sorted({model.key.identity for model, _, _ in avatars})
    models: list[Model] = [model for model, _, _ in avatars]
    for path, identity in files:
        if not _is_baseline(path):
            continue
        if identity is None and len(people) != 1:
            raise OptionError(
                f"{path}: a baseline's file does not say whom it shows; write IDENTITY={path}"
            )
        models.append(TexturedModel(path, identity or people[0]))
    if not models:
        raise OptionError("files is empty; name at least one that `pica export` wrote")
    for key, count in Counter(model.key for model in models).items():
        if count > 1:
            raise OptionError(f"files: {key} is there twice")
    return sorted(models, key=_place)


def _place(model: Model) -> tuple[str, int, str]:
    """What models are sorted by: the person, then the order of the paper's tables."""
    identity, variant, block = model.key
    return identity, list(VARIANTS).index(variant), block or ""


def _files(name: str) -> list[tuple[Path, str | None]]:
    """Path and stated identity of what a word of the command line means."""
    identity, sign, rest = name.partition("=")
    if not sign or Path(name).exists():
        identity, rest = "", name
    path = Path(rest)
    if not path.is_dir():
        return [(path, identity or None)]
    found = sorted(path.glob("*.pica"))
    if not found:
        raise OptionError(f"{path}: no .pica files in this folder")
    return [(file, identity or None) for file in found]


def _is_baseline(path: Path) -> bool:
    """Whether a file says that it is one; what is no such file at all, `load_avatar` refuses."""
    try:
        with safetensors.safe_open(path, "numpy") as file:
            return BASELINE_KEY in (file.metadata() or {})
    except (OSError, safetensors.SafetensorError):
        return False
