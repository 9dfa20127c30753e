"""What boundaries add to the gradient, against finite differences of a supersampled picture."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch
from torch import Tensor

from pica_core.camera import Camera, look_at
from pica_core.train.edge_gradient import edge_term, find_edges, screen_positions
from pica_core.train.rasterise import Hits, Rasteriser, Views, hit_points
from pica_core.types import FloatArray

pytestmark = pytest.mark.train

FINE_SIZE = 384
"""Rows of the picture that the finite differences are made of: a supersampled one."""
BACKGROUND = np.array([0.1, 0.2, 0.3], np.float32)
# A large triangle, and a smaller one 0.3 m before it that covers a part of it and of the
# background: rims against the background and against a surface, at all slopes.
FAR = [[-0.2, -0.2, 0.0], [0.2, -0.15, 0.02], [0.02, 0.2, -0.02]]
NEAR = [[-0.13, -0.02, 0.3], [0.0, -0.05, 0.32], [-0.02, 0.11, 0.3]]
VERTICES = np.array([*FAR, *NEAR], np.float32)
FACES = np.array([[0, 1, 2], [3, 4, 5]], np.int32)
CORNER_COLOURS = np.random.default_rng(0).uniform(0.2, 1, (6, 3)).astype(np.float32)
DIRECTIONS = np.random.default_rng(1).normal(size=(3, 6, 3)).astype(np.float32)


def camera(size: int) -> Camera:
    return look_at(
        centre_m=(0.1, 0.05, 1), target_m=(0, 0, 0), vertical_fov=0.5, width=size, height=size
    )


@pytest.fixture(scope="module")
def rasteriser() -> Iterator[Rasteriser]:
    with Rasteriser(FACES, len(VERTICES)) as made:
        yield made


def hits_of(rasteriser: Rasteriser, vertices: Tensor, view: Camera) -> tuple[Tensor, Tensor, Hits]:
    ids = rasteriser.batch_ids(vertices.detach().numpy()[None].astype(np.float32), [view])[0]
    views = Views.of([view], vertices)
    covered = torch.from_numpy(np.flatnonzero(ids >= 0))
    triangles = torch.from_numpy(ids.reshape(-1)).long()[covered]
    seen = views.see(vertices[None])
    faces = torch.from_numpy(FACES).long()
    hits = hit_points(seen, faces, views, torch.zeros_like(covered), covered, triangles)
    return covered, seen, hits


def picture(
    rasteriser: Rasteriser, vertices: Tensor, view: Camera, colours: FloatArray
) -> tuple[Tensor, Tensor]:
    """The point-sampled picture ``[H * W, 3]`` and its covered pixels."""
    covered, _, hits = hits_of(rasteriser, vertices, view)
    shades = (hits.weights[:, :, None] * torch.from_numpy(colours).to(vertices)[hits.corners]).sum(
        1
    )
    blank = torch.from_numpy(BACKGROUND).to(vertices).expand(view.width * view.height, 3)
    return blank.index_put((covered,), shades), covered


def smooth_weights(size: int) -> FloatArray:
    """What the loss asks of each pixel and channel: slow waves over the image."""
    place = (np.arange(size) + 0.5) / size
    waves = [np.sin(3 * place[:, None] + 4 * place + k) + 0.5 for k in range(3)]
    return np.stack(waves, 2).astype(np.float32).reshape(-1, 3)


def loss_of(rasteriser: Rasteriser, vertices: FloatArray, colours: FloatArray) -> float:
    image, _ = picture(rasteriser, torch.from_numpy(vertices), camera(FINE_SIZE), colours)
    return float((image * torch.from_numpy(smooth_weights(FINE_SIZE))).double().mean())


def slopes_by_gradient(
    rasteriser: Rasteriser, colours: FloatArray, size: int, *, edges: bool
) -> FloatArray:
    """Slopes of the loss along `DIRECTIONS` by the gradient at a picture of `size` rows."""
    vertices = torch.from_numpy(VERTICES).double().requires_grad_()
    view = camera(size)
    image, _ = picture(rasteriser, vertices, view, colours)
    wanted = torch.from_numpy(smooth_weights(size)).double() / (3 * size**2)
    loss = (image * wanted).sum()
    if edges:
        pairs = find_edges(rasteriser.batch_depths_m([view])[0])
        covered, seen, hits = hits_of(rasteriser, vertices, view)
        place = torch.full((size * size,), -1).index_put((covered,), torch.arange(len(covered)))
        front, back = torch.from_numpy(pairs.front), torch.from_numpy(pairs.back)
        of_front = place[front]
        matrix = torch.from_numpy(view.intrinsics)
        positions = screen_positions(
            seen[0], hits.corners[of_front], hits.weights[of_front], matrix
        )
        along = positions.gather(1, torch.from_numpy(pairs.axis)[:, None])[:, 0]
        loss = loss + edge_term(
            image[front],
            image[back],
            wanted[front],
            wanted[back],
            along,
            torch.from_numpy(pairs.sign),
        )
    (gradient,) = torch.autograd.grad(loss, vertices)
    slopes: FloatArray = (DIRECTIONS * gradient.numpy()).sum((1, 2))
    return slopes


def slopes_by_differences(rasteriser: Rasteriser, colours: FloatArray) -> FloatArray:
    step = np.float32(2.5e-3)  # a few pixels of the fine picture: boundaries pass many samples
    slopes = []
    for direction in DIRECTIONS:
        higher = loss_of(rasteriser, VERTICES + step * direction, colours)
        lower = loss_of(rasteriser, VERTICES - step * direction, colours)
        slopes.append((higher - lower) / (2 * step))
    return np.array(slopes)


def error(found: FloatArray, wanted: FloatArray) -> float:
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def test_flat_triangles_move_the_picture_by_their_rims_alone(rasteriser: Rasteriser) -> None:
    flat = np.repeat(CORNER_COLOURS[[0, 3]], 3, 0)
    wanted = slopes_by_differences(rasteriser, flat)

    coarse, fine = (slopes_by_gradient(rasteriser, flat, n, edges=True) for n in (64, 192))
    without = slopes_by_gradient(rasteriser, flat, 64, edges=False)

    assert np.abs(without).max() < 1e-6 * np.abs(wanted).max()
    assert error(coarse, wanted) < 0.25
    assert error(fine, wanted) < 0.7 * error(coarse, wanted)  # falls with the size of pixels


def test_rims_and_shading_together_are_the_gradient_of_the_picture(rasteriser: Rasteriser) -> None:
    wanted = slopes_by_differences(rasteriser, CORNER_COLOURS)

    with_edges = slopes_by_gradient(rasteriser, CORNER_COLOURS, 192, edges=True)
    without = slopes_by_gradient(rasteriser, CORNER_COLOURS, 192, edges=False)

    assert error(with_edges, wanted) < 0.1
    assert error(without, wanted) > 0.5


def test_a_slanted_plane_has_no_boundary_within() -> None:
    depth = np.zeros((8, 8), np.float32)
    depth[2:6, 1:7] = 1 + 0.02 * np.arange(6, dtype=np.float32)  # 20 mm deeper a pixel

    edges = find_edges(depth)

    assert len(edges.front) == 2 * 6 + 2 * 4  # the rim of a rectangle, nothing else
    assert (depth.reshape(-1)[edges.front] > 0).all()
    assert (depth.reshape(-1)[edges.back] == 0).all()


def test_a_step_in_depth_is_a_boundary_of_the_nearer_side() -> None:
    depth = np.ones((4, 6), np.float32)
    depth[:, 3:] = 0.95

    edges = find_edges(depth)

    assert edges.axis.tolist() == [0] * 4
    assert edges.sign.tolist() == [-1] * 4
    assert (edges.front % 6 == 3).all()
    assert (edges.back % 6 == 2).all()
