"""Triangle ids from GL and the interpolation in torch."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from pica_core.camera import Camera, look_at
from pica_core.capture.dataset.files import Topology
from pica_core.errors import ShapeError
from pica_core.train.pixels import MeshDrawer, hit_points, interpolation_weights
from pica_core.train.raster import GLRasteriser, TensorRasteriser, Views
from pica_core.types import IntArray

pytestmark = pytest.mark.train


def front_camera(size: int = 64) -> Camera:
    return look_at(
        centre_m=(0, 0, 1), target_m=(0, 0, 0), vertical_fov=0.5, width=size, height=size
    )


TRIANGLE = np.array([[-0.1, -0.1, 0.0], [0.1, -0.1, 0.05], [0.0, 0.12, -0.05]], np.float32)
FACE = np.array([[0, 1, 2]], np.int32)
TOPOLOGY = Topology(vertex_uv=np.eye(3, 2, dtype=np.float32), faces=FACE, regions={})


def test_a_rasteriser_draws_on_after_another_of_its_thread_is_closed() -> None:
    mesh = torch.from_numpy(TRIANGLE)[None]
    with GLRasteriser(FACE, 3) as first:
        before = first.triangles(mesh, Views.of([front_camera()]))
        with GLRasteriser(FACE, 3) as second:
            second.triangles(mesh, Views.of([front_camera(32)]))
        after = first.triangles(mesh, Views.of([front_camera()]))

    assert (before >= 0).any()
    assert torch.equal(before, after)


def soup(seed: int, count: int = 300) -> tuple[torch.Tensor, IntArray]:
    """Two meshes of small triangles that cover each other, ``[2, 3 F, 3]``, and their faces."""
    rng = np.random.default_rng(seed)
    middles = rng.uniform(-0.3, 0.3, (2, count, 1, 3))  # some beyond the image
    corners = middles + rng.normal(0, 0.03, (2, count, 3, 3))
    faces = np.arange(3 * count, dtype=np.int32).reshape(count, 3)
    return torch.from_numpy(corners.reshape(2, -1, 3).astype(np.float32)), faces


def two_views() -> Views:
    return Views.of(
        [
            look_at(centre_m=(x, 0.1, 1), target_m=(0, 0, 0), vertical_fov=0.5, width=90, height=70)
            for x in (-0.2, 0.0)
        ]
    )


def test_torch_finds_the_triangles_that_gl_finds_but_for_ties_at_edges() -> None:
    meshes, faces = soup(3)
    with GLRasteriser(faces, meshes.shape[1]) as rasteriser:
        wanted = rasteriser.triangles(meshes, two_views())

    found = TensorRasteriser(faces, "cpu").triangles(meshes, two_views())

    assert (wanted >= 0).float().mean() > 0.25
    assert (found != wanted).float().mean() < 2e-3


def test_lists_of_a_fixed_length_say_what_they_left_out() -> None:
    meshes, faces = soup(4)
    one, two = (Views.of([front_camera()] * count) for count in (1, 2))
    rasteriser = TensorRasteriser(faces, "cpu")
    alone = rasteriser.triangles(meshes[:1], one)
    whole = TensorRasteriser(faces, "cpu").triangles(meshes, two)
    rasteriser.capacity.fix()

    assert torch.equal(rasteriser.triangles(meshes[:1], one), alone)
    few = rasteriser.triangles(meshes, two)

    assert torch.equal(few[0], whole[0])
    assert (few[1] >= 0).sum() < (whole[1] >= 0).sum()
    needed = rasteriser.capacity.needed
    assert needed is not None
    assert rasteriser.capacity.was_short(int(needed))
    rasteriser.capacity.fix()
    assert torch.equal(rasteriser.triangles(meshes, two), whole)


def test_pixels_that_fill_up_change_nothing() -> None:
    meshes, faces = soup(5)
    uv = np.random.default_rng(0).random((meshes.shape[1], 2), np.float32)
    drawer = MeshDrawer(
        TensorRasteriser(faces, "cpu"), Topology(vertex_uv=uv, faces=faces, regions={})
    )
    plain = drawer.draw(meshes, two_views())
    drawer.capacity.fix()

    filled = drawer.draw(meshes, two_views())

    assert filled.pixels.shape[1] > plain.pixels.shape[1]
    for ours, theirs in zip(filled.surface, plain.surface, strict=True):
        assert torch.equal(ours[filled.is_drawn], theirs[plain.is_drawn])


def test_important_triangles_are_chosen_more_often() -> None:
    meshes, faces = soup(6)
    uv = np.zeros((meshes.shape[1], 2), np.float32)
    weights = np.where(np.arange(len(faces)) % 2, 4.0, 1.0).astype(np.float32)
    rasteriser = TensorRasteriser(faces, "cpu")
    drawer = MeshDrawer(rasteriser, Topology(vertex_uv=uv, faces=faces, regions={}), weights)
    ids = rasteriser.triangles(meshes, two_views())
    counts = np.zeros(2)

    for shift in range(0, 6300, 450):
        drawn = drawer.draw(meshes, two_views(), count=200, shift=torch.tensor([shift, shift + 9]))
        chosen = ids.gather(1, drawn.pixels)[drawn.is_drawn]
        counts += np.bincount(chosen % 2, minlength=2)
        assert 120 < drawn.is_drawn.sum(1).float().mean() < 280

    covered = np.bincount(ids[ids >= 0] % 2, minlength=2)
    assert counts[1] / covered[1] == pytest.approx(4 * counts[0] / covered[0], rel=0.2)


def test_interpolated_points_project_back_to_their_pixel_centres() -> None:
    camera, mesh = front_camera(), torch.from_numpy(TRIANGLE)[None]
    with GLRasteriser.of(TOPOLOGY) as rasteriser:
        drawn = MeshDrawer(rasteriser, TOPOLOGY).draw(mesh, Views.of([camera]))
        ids = rasteriser.triangles(mesh, Views.of([camera]))
    pixels = drawn.pixels[0].numpy()

    seen, depths = camera.project(drawn.surface.xyz_m[0].numpy())
    assert np.array_equal(pixels, np.flatnonzero(ids >= 0))
    assert np.allclose(seen[:, 0], pixels % 64 + 0.5, atol=1e-3)
    assert np.allclose(seen[:, 1], pixels // 64 + 0.5, atol=1e-3)
    assert np.allclose(depths, drawn.depth_m[0].numpy(), atol=1e-6)


def test_weights_are_perspective_correct() -> None:
    # A segment from depth 1 to depth 3 seen in the middle of its image: two thirds of the way in
    # depth belong to the near end (1/z is linear on the screen, z is not).
    corners = torch.tensor([[[-1.0, 0, 1], [3.0, 0, 3], [-1.0, 5, 1]]], dtype=torch.float64)
    ray = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)

    weights, depth = interpolation_weights(corners, ray)

    assert torch.allclose(weights, torch.tensor([[0.75, 0.25, 0.0]], dtype=torch.float64))
    assert torch.allclose(depth, torch.tensor([1.5], dtype=torch.float64))


def test_weights_keep_their_digits_in_small_triangles_far_away() -> None:
    generator = torch.Generator().manual_seed(1)
    middle = torch.tensor([0.1, -0.2, 1.0], dtype=torch.float64)
    corners = middle + 5e-4 * torch.rand(100, 3, 3, dtype=torch.float64, generator=generator)
    points = corners.mean(1)
    single = corners.float(), (points / points[:, 2:]).float()

    wanted, _ = interpolation_weights(*(values.double() for values in single))
    found, _ = interpolation_weights(*single)

    assert (found - wanted).abs().median() < 1e-4  # without offsets from the ray: 1e-2


@pytest.mark.parametrize(
    "corners",
    [
        pytest.param([[-1, 0, 1], [0, 0, 2], [1, 0, 3]], id="edge-on"),
        pytest.param(
            [[-1, 0, 1], [0, 1e-9, 2], [1, 1e-9, 3]], id="all but edge-on, beside the ray"
        ),
        pytest.param([[0, 0, 1]] * 3, id="of no area"),
    ],
)
def test_a_triangle_that_cannot_be_looked_into_is_met_in_its_middle(
    corners: list[list[float]],
) -> None:
    triangle = torch.tensor([corners], dtype=torch.float32, requires_grad=True)

    weights, _ = interpolation_weights(triangle, torch.tensor([[0.0, 0.0, 1.0]]))

    assert torch.equal(weights, torch.full((1, 3), 1 / 3))
    (gradient,) = torch.autograd.grad(weights[0, 0], triangle)
    assert torch.equal(gradient, torch.zeros(1, 3, 3))


def test_corners_that_are_no_numbers_have_weights_that_are() -> None:
    weights, _ = interpolation_weights(torch.full((1, 3, 3), torch.nan), torch.ones(1, 3))

    assert torch.equal(weights, torch.full((1, 3), 1 / 3))


def test_cameras_of_two_sizes_make_no_batch() -> None:
    with pytest.raises(ShapeError, match="several image sizes"):
        Views.of([front_camera(16), front_camera(17)])


def test_gradients_through_a_batch_of_cameras_agree_with_finite_differences() -> None:
    cameras = [
        look_at(centre_m=(x, 0.1, 1), target_m=(0, 0, 0), vertical_fov=0.5, width=24, height=32)
        for x in (-0.2, 0.0)
    ]
    meshes = torch.from_numpy(np.stack([TRIANGLE, 1.1 * TRIANGLE])).double()
    faces = torch.from_numpy(FACE).long()
    views = Views.of(cameras, meshes)
    ids = TensorRasteriser(FACE, "cpu").triangles(meshes, views)
    pixels = torch.stack([torch.nonzero(own >= 0)[:40:7, 0] for own in ids])

    def points(values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        rays = views.rays(pixels)
        weights, depth_m = hit_points(views.see(values), faces, torch.zeros_like(pixels), rays)
        return weights, views.to_head(rays * depth_m[:, :, None])

    assert torch.autograd.gradcheck(points, (meshes.requires_grad_(),))


def test_the_normals_of_a_plane_are_its_own_where_neighbours_are_drawn() -> None:
    mesh = torch.from_numpy(TRIANGLE)[None]
    drawer = MeshDrawer(TensorRasteriser(FACE, "cpu"), TOPOLOGY)
    drawn = drawer.draw(mesh, Views.of([front_camera()]))
    a, b, c = mesh[0]
    wanted = torch.linalg.cross(b - a, c - a) @ drawn.views.rotation[0].T

    right, below = drawn.beside(drawn.is_drawn)
    found = drawn.normals(drawn.depth_m)[right & below]

    assert 0 < len(found) < drawn.pixels.shape[1]
    assert torch.allclose(found, (wanted / wanted.norm()).expand_as(found), atol=1e-3)


def test_triton_is_loaded_before_a_driver_can_be(tmp_path: Path) -> None:
    # After Mesa's LLVM it ends the process; the wheel of torch that tests install has none of it.
    (tmp_path / "triton.py").write_text("")
    program = "import sys, pica_core.train.raster; assert 'triton' in sys.modules"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    subprocess.run([sys.executable, "-c", program], env=environment, check=True)
