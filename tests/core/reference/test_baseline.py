"""The baseline: the published sizes, and a face that looks like the avatar it stands beside."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.decode.decoder import onnxruntime
from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.spec import AvatarSpec
from pica_core.graphs.onnx_graph import baseline_graph
from pica_core.reference.baseline import BaselineAvatar, BaselineSpec, baseline_like
from pica_core.reference.decoders import decode_expression_map, decode_pixels
from pica_core.sampling import sample_bilinear, sample_vertices
from pica_core.types import Array

pytestmark = [pytest.mark.unit, pytest.mark.slow]

TOY = make_toy_avatar(grid=12, spec=AvatarSpec(uv_encoding_size=16, axis_encoding_size=20))
SMALL = BaselineSpec(num_latent=6, num_vertices=5, channels=(4, 3))


@pytest.fixture(scope="module")
def dressed() -> BaselineAvatar:
    return baseline_like(TOY, seed=3)


def run(graph: bytes, latent: Array, view: Array) -> list[Array]:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    feeds = {"latent": latent[None], "view_direction": view[None]}
    outputs: list[Array] = session.run(
        ["vertices", "texture"], {k: v.astype(np.float32) for k, v in feeds.items()}
    )
    return outputs


def test_the_published_sizes_have_17_4_million_parameters_and_755_million_multiply_adds() -> None:
    spec = BaselineSpec()
    assert spec.texture_size == 1024
    assert spec.num_parameters == pytest.approx(17.4e6, rel=3e-3)
    fully_connected = 256 * 256 + 3 * 8 + 256 * 3 * 7306 + 264 * 4096
    assert spec.multiply_adds - fully_connected == pytest.approx(755e6, rel=1e-3)


def test_a_dressed_baseline_shows_the_mean_mesh_and_the_neutral_colours(
    dressed: BaselineAvatar,
) -> None:
    latent = np.random.default_rng(4).standard_normal(256)
    vertices, texture = run(baseline_graph(dressed), latent, np.array([0.0, 0.0, 1.0]))
    mesh_m = sample_vertices(TOY.tensors["geometry.mean"], dressed.vertex_uv)
    assert np.linalg.norm(vertices - mesh_m, axis=1).max() < 2e-3
    where = np.random.default_rng(5).uniform(0.01, 0.99, (500, 2)).astype(np.float32)
    neutral = ExpressionEncoder(TOY).encode(np.zeros(NUM_ARKIT))
    codes = decode_expression_map(TOY, neutral, (0.0, 0.0, 1.0))
    wanted = decode_pixels(
        TOY.spec,
        TOY.tensors,
        sample_bilinear(codes, where),
        sample_bilinear(TOY.tensors["geometry.mean"], where),
        where,
    )
    colours = sample_bilinear(texture, where)
    assert np.sqrt(np.mean((colours - np.clip(wanted, 0, 1)) ** 2)) < 0.05
    assert np.ptp(colours) > 0.3, "the test would not notice a grey face"


def test_latent_and_view_move_the_dressed_baseline(dressed: BaselineAvatar) -> None:
    graph, rng = baseline_graph(dressed), np.random.default_rng(6)
    latent = rng.standard_normal(256)
    before = run(graph, latent, np.array([0.0, 0.0, 1.0]))
    turned = run(graph, latent, np.array([1.0, 0.0, 0.0]))
    moved = run(graph, -latent, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_array_equal(before[0], turned[0])
    assert np.abs(before[1] - turned[1]).max() > 1e-4
    assert np.abs(before[0] - moved[0]).max() > 1e-5


def test_the_mesh_is_the_level_nearest_to_the_published_one() -> None:
    avatar = with_toy_levels(make_toy_avatar(grid=100, spec=TOY.spec))
    sizes = {level: len(avatar.level_faces(level)) for level in avatar.levels}
    assert min(sizes, key=lambda level: abs(sizes[level] - 10_936)) == 128
    assert len(baseline_like(avatar).faces) == sizes[128]
