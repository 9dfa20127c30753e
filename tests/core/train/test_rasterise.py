"""Triangle ids from GL and the interpolation in torch."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from pica_core.camera import Camera, look_at
from pica_core.capture.dataset.dataset import Topology
from pica_core.errors import ShapeError
from pica_core.train.raster import (
    MeshDrawer,
    Rasteriser,
    Views,
    hit_points,
    interpolation_weights,
)

pytestmark = pytest.mark.train


def front_camera(size: int = 64) -> Camera:
    return look_at(
        centre_m=(0, 0, 1), target_m=(0, 0, 0), vertical_fov=0.5, width=size, height=size
    )


TRIANGLE = np.array([[-0.1, -0.1, 0.0], [0.1, -0.1, 0.05], [0.0, 0.12, -0.05]], np.float32)
FACE = np.array([[0, 1, 2]], np.int32)
TOPOLOGY = Topology(vertex_uv=np.eye(3, 2, dtype=np.float32), faces=FACE, regions={})


def test_a_rasteriser_draws_on_after_another_of_its_thread_is_closed() -> None:
    with Rasteriser(FACE, 3) as first:
        before = first.triangle_ids(TRIANGLE[None], [front_camera()])
        with Rasteriser(FACE, 3) as second:
            second.triangle_ids(TRIANGLE[None], [front_camera(32)])
        after = first.triangle_ids(TRIANGLE[None], [front_camera()])

    assert (before >= 0).any()
    np.testing.assert_array_equal(before, after)


def test_interpolated_points_project_back_to_their_pixel_centres() -> None:
    camera = front_camera()
    with Rasteriser.of(TOPOLOGY) as rasteriser:
        drawn = MeshDrawer(rasteriser, TOPOLOGY).draw(torch.from_numpy(TRIANGLE)[None], [camera])
        ids = rasteriser.triangle_ids(TRIANGLE[None], [camera])
    pixels = drawn.pixels

    seen, depths = camera.project(drawn.surface.xyz_m.numpy())
    assert np.array_equal(pixels, np.flatnonzero(ids >= 0))
    assert np.allclose(seen[:, 0], pixels % 64 + 0.5, atol=1e-3)
    assert np.allclose(seen[:, 1], pixels // 64 + 0.5, atol=1e-3)
    assert np.allclose(depths, drawn.depth_m.numpy(), atol=1e-6)


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
    with Rasteriser(FACE, 3) as rasteriser, pytest.raises(ShapeError, match="several image sizes"):
        rasteriser.triangle_ids(np.stack([TRIANGLE] * 2), [front_camera(16), front_camera(17)])


def test_gradients_through_a_batch_of_cameras_agree_with_finite_differences() -> None:
    cameras = [
        look_at(centre_m=(x, 0.1, 1), target_m=(0, 0, 0), vertical_fov=0.5, width=24, height=32)
        for x in (-0.2, 0.0)
    ]
    meshes = torch.from_numpy(np.stack([TRIANGLE, 1.1 * TRIANGLE])).double()
    faces = torch.from_numpy(FACE).long()
    with Rasteriser(FACE, 3) as rasteriser:
        ids = rasteriser.triangle_ids(meshes.float().numpy(), cameras)
    image, pixels = (torch.from_numpy(a) for a in np.nonzero(ids.reshape(2, -1) >= 0))
    some = torch.arange(0, len(image), 7)
    image, pixels = image[some], pixels[some]
    views = Views.of(cameras, meshes)
    assert set(image.tolist()) == {0, 1}

    def points(values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        triangles = torch.zeros_like(pixels)
        weights, depth_m, rays = hit_points(
            views.see(values), faces, views, image, pixels, triangles
        )
        return weights, views.to_head(image, rays * depth_m[:, None])

    assert torch.autograd.gradcheck(points, (meshes.requires_grad_(),))


def test_triton_is_loaded_before_a_driver_can_be(tmp_path: Path) -> None:
    # After Mesa's LLVM it ends the process; the wheel of torch that tests install has none of it.
    (tmp_path / "triton.py").write_text("")
    program = "import sys, pica_core.train.raster; assert 'triton' in sys.modules"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    subprocess.run([sys.executable, "-c", program], env=environment, check=True)
