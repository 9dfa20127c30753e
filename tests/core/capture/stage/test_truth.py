"""Images, depth, masks, poses and meshes of a capture agree, to fractions of pixels and of mm."""

from pathlib import Path

import numpy as np
import pytest

from helpers.small_capture import render_capture, small_subject
from pica_core.camera import Camera, dome_cameras
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.stage.expressions import blend
from pica_core.capture.stage.synth import RenderOptions
from pica_core.capture.triangles import vertex_normals
from pica_core.sampling import sample_bilinear

pytestmark = pytest.mark.render

SEEN_M = 0.001
"""A vertex is seen if the surface at its pixel is no farther in front of it."""


def seen(
    camera: Camera, vertices_m: np.ndarray, faces: np.ndarray, depth_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Which vertices a camera sees well; row and column of their pixels; their exact places."""
    pixels, distance = camera.project(vertices_m)
    way = camera.centre_m - vertices_m
    facing = (vertex_normals(vertices_m, faces) * way).sum(1) > 0.7 * np.linalg.norm(way, axis=1)
    column, row = np.floor(pixels).astype(int).T
    inside = (column > 0) & (row > 0) & (column < camera.width - 1) & (row < camera.height - 1)
    index = np.flatnonzero(facing & inside)
    depth = depth_m[row[index], column[index]]
    index = index[(depth > 0) & (np.abs(depth - distance[index]) < SEEN_M)]
    return index, row[index], column[index], pixels[index]


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    out: Path = tmp_path_factory.mktemp("capture") / "S1"
    render_capture(
        RenderOptions(frames=4, cameras=3, size="320x240", texture_size=64, tracked_vertices=900),
        out,
    )
    return Capture.open(out)


def test_exact_depth_is_that_of_the_mesh_without_a_shift_of_half_a_pixel(capture: Capture) -> None:
    slopes, errors = [], []
    for frame in capture.frames[1:3]:
        for name in capture.cameras_of(frame):
            camera, vertices = capture.head_camera(frame, name), capture.true_vertices_m(frame)
            depth_m = capture.depth_m(frame, name)
            index, row, column, pixels = seen(camera, vertices, capture.topology.faces, depth_m)
            assert len(index) > 500
            down, across = np.gradient(depth_m)
            offset = np.stack([column + 0.5, row + 0.5], 1) - pixels
            slope = np.stack([across[row, column], down[row, column]], 1)
            flat = np.abs(slope).max(1) < 0.002  # no step of depth beside it
            error = depth_m[row, column] - camera.project(vertices[index])[1]
            errors.append((error - (slope * offset).sum(1))[flat])
            slopes.append(slope[flat])
    error, slope = np.concatenate(errors), np.concatenate(slopes)
    assert np.quantile(np.abs(error), 0.9) < 0.0003
    shift_px = np.linalg.lstsq(slope, error, rcond=None)[0]
    assert np.abs(shift_px).max() < 0.1


def test_a_texture_of_other_cameras_shows_a_held_out_one() -> None:
    held_out, *cameras = dome_cameras(9, 320, 320)
    subject = small_subject(bake_size=512)
    vertices = subject.pose(blend(jawOpen=0.2, mouthSmile=0.4))
    _, texture = subject.photograph(cameras, 512)
    view, topology = subject.draw(held_out), subject.topology
    subject.release()

    index, row, column, _ = seen(held_out, vertices, topology.faces, view.depth_m)
    uv = topology.vertex_uv[index]
    known = sample_bilinear(texture.any(-1, keepdims=True).astype(np.float32), uv)[:, 0] > 0.999
    drawn = sample_bilinear(texture.astype(np.float32), uv)[known]
    error = np.square(view.image[row, column][known] - drawn)

    assert known.sum() > 500
    assert 10 * np.log10(255**2 / error.mean()) >= 25.0
