"""Vertices by bases: torch, numpy and the ONNX graph say the same, and a file says it again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from helpers.toy import grid_faces, make_toy_avatar, with_toy_levels
from helpers.trainable import grid_uv, toy_linear_prior
from pica_client.decode.decoder import onnxruntime
from pica_core.avatar.file import Avatar, load_avatar, save_avatar
from pica_core.avatar.spec import AvatarSpec
from pica_core.errors import AvatarFileError
from pica_core.graphs import decoder_graph
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.model.interface import ModelOptions
from pica_core.model.linear import CODE_LOG_VARIANCE
from pica_core.reference import decode_position_map
from pica_core.train.export import avatar_tensors
from pica_core.types import Array

pytestmark = pytest.mark.train

GRID = 24
AGREEMENT_M = 2e-8
MEAN_ROUNDING_M = 5e-6
"""16 bits over a head."""


@pytest.fixture(scope="module")
def model() -> PixelCodecAvatar:
    torch.manual_seed(1)
    spec = AvatarSpec(uv_encoding_size=16, axis_encoding_size=20, geometry="bases", block="G")
    return PixelCodecAvatar(
        spec,
        toy_linear_prior(dense=GRID),
        ModelOptions(encoding_amplitude=1.0, texture_contrast=0.0),
    )


@pytest.fixture(scope="module")
def avatar(model: PixelCodecAvatar) -> Avatar:
    toy = make_toy_avatar(spec=replace(model.spec, geometry="decoder"))
    manifest = replace(toy.manifest, spec=model.spec, position_scale_m=model.position_scale_m)
    tensors = avatar_tensors(model, grid_uv(GRID), grid_faces(GRID, GRID))
    return with_toy_levels(Avatar(manifest, tensors))


def run(graph: bytes, latent: Array) -> tuple[Array, Array]:
    session = onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])
    feeds = {"latent": latent[None], "view_direction": np.array([[0, 0, 1]], np.float32)}
    position, expression = session.run(["position_map", "expression_map"], feeds)
    return position, expression


@pytest.fixture(scope="module")
def latent() -> Array:
    return np.random.default_rng(2).standard_normal((8, 8, 4)).astype(np.float32)


def test_torch_numpy_and_the_graph_make_the_same_vertices(
    model: PixelCodecAvatar, avatar: Avatar, latent: Array
) -> None:
    wanted = decode_position_map(avatar, latent)
    assert wanted.shape == (3, 256, 3)
    moved = avatar.vertices_of(wanted, 256) - avatar.mean_vertices_m
    assert np.abs(moved).max() > 1e-3, "the test would not notice bases that do nothing"
    position, _ = run(decoder_graph(avatar), latent)
    assert np.abs(position - wanted).max() <= AGREEMENT_M
    with torch.no_grad():
        mesh = model.decode_mesh(torch.from_numpy(latent).permute(2, 0, 1)[None])
    order = model.geometry.order.numpy()  # type: ignore[union-attr]
    in_torch = mesh.vertices_m[0].numpy()[order]
    assert np.abs(avatar.vertices_of(wanted, 256) - in_torch).max() <= 10 * AGREEMENT_M


@pytest.mark.parametrize("level", [64, 128])
def test_a_coarser_level_has_exactly_the_full_levels_vertices(
    avatar: Avatar, latent: Array, level: int
) -> None:
    used = np.unique(avatar.level_faces(level))
    full = decode_position_map(avatar, latent).reshape(-1, 3)[used]
    position, _ = run(decoder_graph(avatar, level=level), latent)
    assert position.shape == (avatar.position_rows(level), level, 3)
    assert np.abs(avatar.vertices_of(position, level) - full).max() <= AGREEMENT_M
    assert np.abs(position - decode_position_map(avatar, latent, level)).max() <= AGREEMENT_M


def test_a_file_holds_the_bases_to_the_last_bit(
    avatar: Avatar, latent: Array, tmp_path: Path
) -> None:
    save_avatar(tmp_path / "a.pica", avatar)
    loaded = load_avatar(tmp_path / "a.pica")
    assert loaded.spec == avatar.spec
    for name in ("weight", "bias", "mix", "basis", "rank"):
        assert np.array_equal(loaded.tensors[f"linear.{name}"], avatar.tensors[f"linear.{name}"])
    difference = decode_position_map(loaded, latent) - decode_position_map(avatar, latent)
    assert np.abs(difference).max() <= MEAN_ROUNDING_M


def test_the_encoders_first_channel_is_the_closed_forms(model: PixelCodecAvatar) -> None:
    maps = torch.randn(2, 3, 256, 256)
    mean, log_variance = model.encoder(torch.zeros(2, 3, 256, 256), maps)
    assert torch.all(log_variance[:, 0] == CODE_LOG_VARIANCE)
    again, _ = model.encoder(torch.ones(2, 3, 256, 256), maps)
    assert torch.equal(mean[:, 0], again[:, 0])
    assert not torch.equal(mean[:, 1:], again[:, 1:])


def test_a_checkpoint_brings_its_own_regions(model: PixelCodecAvatar) -> None:
    other = PixelCodecAvatar(
        model.spec,
        toy_linear_prior(dense=GRID),
        ModelOptions(encoding_amplitude=1.0, texture_contrast=0.0),
    )
    state = {name: values.clone() for name, values in model.state_dict().items()}
    state["geometry.mix"], state["geometry.basis"] = (
        torch.cat([state[f"geometry.{name}"]] * 2) for name in ("mix", "basis")
    )
    state["geometry.rank"] = 2 * state["geometry.rank"]
    other.load_state_dict(state)
    assert len(other.state_dict()["geometry.mix"]) == len(state["geometry.mix"])


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("rank", lambda a: a - a.max() - 1, "allowed are 0 to"),
        ("rank", lambda a: a + 100, "allowed are 0 to"),
        ("rank", lambda a: np.where(np.arange(len(a)) == 0, 0, a), "adds up to"),
        ("rank", lambda a: a.astype(np.float32), "int32 is needed"),
        ("rank", lambda a: a[:-1], "linear.rank has shape"),
        ("mix", lambda a: np.zeros((0, a.shape[1]), np.float32), "mix has 0 rows"),
        ("mix", lambda a: np.zeros((9000, a.shape[1]), np.float32), "1 to 8192"),
        ("mix", lambda a: np.zeros((len(a), 200), np.float32), "1 to 128"),
        ("mix", lambda a: a * np.inf, "not finite"),
        ("mix", lambda a: 300 * a, "moved by linear.*, cover .* the limit is 600"),
        ("weight", lambda a: 300 * a, "moved by linear.*, cover .* the limit is 600"),
        ("bias", lambda a: a + 3000, "moved by linear.*, cover .* the limit is 600"),
        ("basis", lambda a: a[:, :, :2], "linear.basis has shape"),
        ("basis", lambda a: a + np.float32(np.nan), "not finite"),
        ("weight", lambda a: a[:, :4], r"linear.weight has shape"),
        ("mean", lambda a: a[:-1], "linear.mean has shape"),
    ],
)
def test_hostile_bases_are_refused(
    avatar: Avatar, tmp_path: Path, name: str, change: object, message: str
) -> None:
    assert callable(change)
    with np.errstate(invalid="ignore"):
        changed = change(avatar.tensors[f"linear.{name}"])
    tensors = {**avatar.tensors, f"linear.{name}": changed}
    with pytest.raises(AvatarFileError, match=message):
        save_avatar(tmp_path / "bad.pica", Avatar(avatar.manifest, tensors))
