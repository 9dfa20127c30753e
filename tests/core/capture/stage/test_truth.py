"""Images, depth, masks, poses and meshes of a capture agree, to fractions of pixels and of mm."""

from __future__ import annotations

from dataclasses import dataclass

import moderngl
import numpy as np
import pytest

from helpers.small_capture import render_capture, small_subject
from pica_core.camera import Camera
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.stage.dome import dome_cameras
from pica_core.capture.stage.expressions import blend
from pica_core.capture.stage.synth import RenderOptions
from pica_core.gl import create_context, link_program
from pica_core.reference.sampling import sample_bilinear

pytestmark = pytest.mark.render

VERTEX = """#version 330 core
uniform mat4 clip_from_head;
in vec3 position_m;
void main() { gl_Position = clip_from_head * vec4(position_m, 1.0); }
"""
FRAGMENT = """#version 330 core
out float triangle;
void main() { triangle = float(gl_PrimitiveID + 1); }
"""


class IdImages:
    """Which triangle each pixel shows, drawn by other code than the stage's."""

    def __init__(self) -> None:
        self._context = create_context()
        self._program = link_program(self._context, vertex=VERTEX, fragment=FRAGMENT)

    def release(self) -> None:
        self._context.gc()
        self._context.release()

    def draw(self, camera: Camera, vertices_m: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """int ``[H, W]``, -1 for the background, row 0 on top."""
        context = self._context
        array = context.vertex_array(
            self._program,
            [(context.buffer(vertices_m.astype("f4").tobytes()), "3f", "position_m")],
            index_buffer=context.buffer(faces.astype("i4").tobytes()),
        )
        size = camera.width, camera.height
        target = context.framebuffer(
            [context.texture(size, 1, dtype="f4")], context.depth_renderbuffer(size)
        )
        target.use()
        target.clear(0.0, 0.0, 0.0, 0.0)
        context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        matrix = camera.clip_from_world(0.05, 6.0).T
        self._program["clip_from_head"].write(np.ascontiguousarray(matrix).tobytes())
        array.render()
        ids = np.frombuffer(target.read(components=1, dtype="f4"), np.float32)
        del array, target
        context.gc()
        return ids.reshape(camera.height, camera.width)[::-1].astype(int) - 1


def rays(camera: Camera) -> np.ndarray:
    """Directions through pixel centres in camera axes, z = 1. ``[H, W, 3]``."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([x, y, np.ones_like(x)], -1)
    return pixels @ np.linalg.inv(camera.intrinsics).T


@dataclass(frozen=True)
class Look:
    """One image of a capture with everything about it, read from its files."""

    camera: Camera
    vertices_m: np.ndarray
    faces: np.ndarray
    ids: np.ndarray
    depth_m: np.ndarray
    mask: np.ndarray


@pytest.fixture(scope="module")
def looks(tmp_path_factory: pytest.TempPathFactory) -> list[Look]:
    out = tmp_path_factory.mktemp("capture") / "S1"
    options = RenderOptions(
        frames=4,
        cameras=3,
        size="320x240",
        texture_size=64,
        tracked_vertices=900,
    )
    render_capture(options, out)
    capture = Capture.open(out)
    images = IdImages()
    result = []
    for frame in capture.frames[1:3]:
        for name in capture.cameras_of(frame):
            camera = capture.head_camera(frame, name)
            vertices = capture.true_vertices_m(frame)
            result.append(
                Look(
                    camera=camera,
                    vertices_m=vertices,
                    faces=capture.topology.faces,
                    ids=images.draw(camera, vertices, capture.topology.faces),
                    depth_m=capture.true_depth_m(frame, name),
                    mask=capture.mask(frame, name),
                )
            )
    images.release()
    return result


def test_vertices_project_to_where_their_triangles_are_seen(looks: list[Look]) -> None:
    distances, offsets = [], []
    for look in looks:
        row, column = np.nonzero(look.ids >= 0)
        centres = np.repeat(np.stack([column, row], -1) + 0.5, 3, axis=0)
        corners = look.faces[look.ids[row, column]].reshape(-1)
        pixels, _ = look.camera.project(look.vertices_m)
        offset = centres - pixels[corners]
        distance = np.linalg.norm(offset, axis=1)
        # Of every vertex whose triangles are seen around it, the nearest pixel of one of them.
        order = np.lexsort([distance, corners])
        first = order[np.unique(corners[order], return_index=True)[1]]
        seen = first[distance[first] < 3.0]  # farther: the vertex itself is hidden
        assert len(seen) > 1000
        assert len(seen) > 0.85 * len(first)
        distances.append(distance[seen])
        offsets.append(offset[seen])

    assert np.concatenate(distances).mean() <= 0.6
    assert np.abs(np.concatenate(offsets).mean(axis=0)).max() < 0.1  # no half-pixel shift


def test_exact_depth_lies_on_the_surface(looks: list[Look]) -> None:
    for look in looks:
        both = (look.ids >= 0) & (look.depth_m > 0)
        assert both.sum() > 10_000
        assert (both == (look.mask > 0)).mean() > 0.9999  # the silhouettes are the same pixels
        point = (rays(look.camera) * look.depth_m[..., None])[both]
        point = (point - look.camera.translation_m) @ look.camera.rotation
        a, b, c = (look.vertices_m[look.faces[look.ids[both], i]].astype(float) for i in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)
        distance = np.abs(((point - a) * normal).sum(axis=1))
        # Where two surfaces meet within a pixel's rounding either may be the nearest.
        assert (distance > 0.0002).mean() < 1e-4
        assert distance.mean() < 0.00005


@pytest.fixture(scope="module")
def rerendered() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A held-out camera's image, the same from a texture of the others, and where that is known."""
    cameras = dome_cameras(9, 320, 320)
    held_out = cameras[0]
    subject = small_subject(bake_size=512)
    vertices = subject.pose(blend(jawOpen=0.2, mouthSmile=0.4))
    views = [(camera, subject.draw(camera)) for camera in cameras[1:]]
    texture, covered = subject.unwrap(views, 512)
    image = subject.draw(held_out).image
    topology = subject.topology
    subject.release()
    images = IdImages()
    ids = images.draw(held_out, vertices, topology.faces)
    images.release()
    seen = ids >= 0
    direction = (rays(held_out) @ held_out.rotation)[seen]
    corners = topology.faces[ids[seen]]
    places = [vertices[corners[:, i]] - held_out.centre_m for i in range(3)]
    weights = np.stack(
        [(direction * np.cross(places[i - 2], places[i - 1])).sum(axis=1) for i in range(3)], -1
    )
    weights /= weights.sum(axis=1, keepdims=True)
    uv = (topology.vertex_uv[corners] * weights[..., None]).sum(axis=1)
    known = sample_bilinear(covered[..., None].astype(np.float32), uv)[:, 0] > 0.999
    drawn = np.zeros(image.shape)
    drawn[seen] = sample_bilinear(texture.astype(np.float32), uv)
    visible = np.zeros(seen.shape, bool)
    visible[seen] = known
    return image, drawn, visible


def test_a_texture_of_other_cameras_shows_a_held_out_one(
    rerendered: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    image, drawn, visible = rerendered
    assert visible.mean() > 0.2
    error = np.square(image[visible] - drawn[visible])
    assert 10 * np.log10(255**2 / error.mean()) >= 30.0
