"""Every loss against an independent twin, and on a case that one can follow."""

import math

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import Tensor

from pica_core.train import losses
from pica_core.train.losses import follow_mean, laplacian_smoothness, mesh_laplacian
from pica_core.types import Float64Array

pytestmark = pytest.mark.train


def random(*shape: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(*shape, dtype=torch.float64, generator=generator)


def one_image(mask: Tensor) -> Tensor:
    """Shares of pixels that are all of one image."""
    return losses.equal_shares(mask[None], torch.float64)[0]


def test_images_share_alike_whatever_their_numbers_of_pixels() -> None:
    mask = torch.tensor([[True, True, False, True], [True, False, False, False], [False] * 4])

    shares = losses.equal_shares(mask)

    wanted = [[1 / 9, 1 / 9, 0, 1 / 9], [1 / 3, 0, 0, 0], [0, 0, 0, 0]]
    assert torch.allclose(shares, torch.tensor(wanted))


# --- image, mesh, KL


def test_image_mesh_and_normal_loss_agree_with_numpy() -> None:
    predicted, observed = random(5, 3), random(5, 3, seed=1)
    squares = np.square(predicted.numpy() - observed.numpy())
    found = float(
        losses.image_loss(predicted, observed, one_image(torch.ones(5, dtype=torch.bool)))
    )
    assert found == pytest.approx(squares.mean(), rel=1e-12)

    meshes, tracked, weights = random(2, 4, 3), random(2, 4, 3, seed=1), random(4, seed=2)
    weights[2] = 0
    apart = np.square(1000 * (meshes.numpy() - tracked.numpy())).sum(2)
    wanted = np.average(apart, axis=1, weights=weights.numpy()).mean()
    assert float(losses.mesh_loss(meshes, tracked, weights)) == pytest.approx(wanted, rel=1e-12)

    share = one_image(torch.ones(5, dtype=torch.bool))
    found = float(losses.normal_loss(predicted, observed, share))
    assert found == pytest.approx(3 * squares.mean(), rel=1e-12)


def test_the_divergence_agrees_with_its_integral() -> None:
    mean, log_variance = 0.7, -0.8
    deviation = math.exp(log_variance / 2)
    x = np.linspace(mean - 12 * deviation, mean + 12 * deviation, 20_001)
    ours = np.exp(-0.5 * ((x - mean) / deviation) ** 2) / (deviation * math.sqrt(2 * math.pi))
    log_ratio = -0.5 * ((x - mean) / deviation) ** 2 - math.log(deviation) + 0.5 * x**2
    integral = float((ours * log_ratio).sum() * (x[1] - x[0]))

    value = losses.kl_loss(
        torch.full((1, 4, 8, 8), mean, dtype=torch.float64),
        torch.full((1, 4, 8, 8), log_variance, dtype=torch.float64),
    )

    assert float(value) == pytest.approx(integral, rel=1e-9)


# --- depth


def test_depth_loss_agrees_with_numpy() -> None:
    predicted, observed = 1 + 0.03 * random(50), 1 + 0.03 * random(50, seed=1)
    observed[::7] = 0
    known = observed.numpy() > 0
    errors = 1000 * np.abs(predicted.numpy() - observed.numpy())[known]

    mask = losses.depth_mask(predicted, observed)

    assert 5 < int(mask.sum()) < 45
    share = one_image(observed > 0)
    found = float(losses.depth_loss(predicted, observed, mask, share))
    assert found == pytest.approx(np.where(errors < 10, errors, 0).mean(), rel=1e-12)


# --- smoothness


def test_gradient_smoothness_agrees_with_numpy() -> None:
    values = random(2, 3, 4, 5)
    steps = [np.square(1000 * np.diff(values.numpy(), axis=axis)) for axis in (3, 2)]
    wanted = sum(np.sqrt(step.mean((1, 2, 3))).mean() for step in steps)
    assert float(losses.gradient_smoothness(values)) == pytest.approx(wanted, rel=1e-9)


def naive_laplacian(points: Float64Array, faces: npt.NDArray[np.int32]) -> Float64Array:
    """L as a dense matrix: angles by arc tangent, triangle by triangle."""
    count = len(points)
    matrix = np.zeros((count, count))
    for face in faces:
        for corner in range(3):
            apex, i, j = (int(face[(corner + k) % 3]) for k in range(3))
            one, two = points[i] - points[apex], points[j] - points[apex]
            angle = math.atan2(float(np.linalg.norm(np.cross(one, two))), float(one @ two))
            half = 0.5 / math.tan(angle)
            matrix[i, j] += half
            matrix[j, i] += half
    matrix[matrix != 0] = np.maximum(matrix[matrix != 0], 1e-6)
    for i in range(count):
        matrix[i] /= -matrix[i].sum()
        matrix[i, i] = 1
    return matrix


def test_laplacian_smoothness_agrees_with_a_dense_matrix_and_a_finite_difference() -> None:
    rng = np.random.default_rng(0)
    neutral = rng.normal(size=(5, 3))
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [1, 2, 3]], np.int32)
    laplacian = mesh_laplacian(neutral, faces, random(1))
    meshes = torch.from_numpy(rng.normal(size=(2, 5, 3))).requires_grad_()
    mean = torch.from_numpy(rng.normal(size=(5, 3)))
    weights = torch.tensor([0.25, 1.25, 0.25, 0.25, 1.25], dtype=torch.float64)

    value = laplacian_smoothness(laplacian, meshes, mean, weights)

    offset = 1000 * (meshes.detach().numpy() - mean.numpy())
    dense = weights.numpy()[:, None] * (naive_laplacian(neutral, faces) @ offset)
    assert float(value.detach()) == pytest.approx(
        float(np.sqrt(np.square(dense).mean((1, 2))).mean()), rel=1e-9
    )
    assert torch.autograd.gradcheck(
        lambda m: laplacian_smoothness(laplacian, m, mean, weights), (meshes,)
    )


def test_triangles_without_area_leave_the_laplacian_finite() -> None:
    points = np.zeros((4, 3))
    points[3] = (1, 0, 0)
    faces = np.array([[0, 1, 2], [0, 1, 3]], np.int32)

    laplacian = mesh_laplacian(points, faces, random(1))

    assert torch.isfinite(laplacian.of(torch.from_numpy(points))).all()


def test_the_mean_mesh_follows_slowly_and_without_gradient() -> None:
    mean = torch.zeros(2, 3, dtype=torch.float64)
    meshes = torch.stack([torch.ones(2, 3), 3 * torch.ones(2, 3)]).double().requires_grad_()

    follow_mean(mean, meshes)

    assert torch.allclose(mean, torch.full((2, 3), 2e-4, dtype=torch.float64))
    assert not mean.requires_grad
