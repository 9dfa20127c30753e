"""Pictures of a mesh with its texture, without light: what networks find faces in.

Light on skin is in a scan's texture already. What has no colours is drawn in shades of its slope.
"""

from typing import Any, Self

import moderngl
import numpy as np

from pica_core.camera import Camera
from pica_core.capture.me.scan import Scan
from pica_core.capture.stage.subject import View
from pica_core.capture.triangles import vertex_normals
from pica_core.gl import create_context, link_program
from pica_core.types import Float64Array

BACKGROUND = 0.36
VERTEX = """#version 330
uniform mat4 clip_from_world;
uniform vec4 depth_plane;
in vec3 place;
in vec2 uv;
in vec3 colour;
out vec2 at;
out vec3 tint;
out float depth;
void main() {
    at = uv;
    tint = colour;
    depth = dot(depth_plane, vec4(place, 1.0));
    gl_Position = clip_from_world * vec4(place, 1.0);
}
"""
FRAGMENT = """#version 330
uniform sampler2D image;
in vec2 at;
in vec3 tint;
in float depth;
layout(location = 0) out vec4 colour;
layout(location = 1) out float depth_out;
void main() {
    colour = vec4(texture(image, at).rgb * tint, 1.0);
    depth_out = depth;
}
"""


class MeshViews:
    """Draws a scan whose vertices may be moved; a context manager, of one thread."""

    def __init__(self, scan: Scan) -> None:
        self._context: Any = create_context()
        self._scan = scan
        self._program: Any = link_program(self._context, vertex=VERTEX, fragment=FRAGMENT)
        c = self._context
        self._image = c.texture(scan.image.shape[1::-1], 3, scan.image.tobytes(), alignment=1)
        self._image.build_mipmaps()
        self._places = c.buffer(reserve=12 * len(scan.points), dynamic=True)
        uv = c.buffer(scan.uv.astype("f4").tobytes())
        self._colours = c.buffer(reserve=12 * len(scan.points), dynamic=True)
        content = [(self._places, "3f", "place"), (uv, "2f", "uv"), (self._colours, "3f", "colour")]
        faces = c.buffer(np.ascontiguousarray(scan.faces, "i4").tobytes())
        self._mesh = c.vertex_array(self._program, content, faces)
        self._target: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.gc()
        self._context.release()

    def move(self, points: Float64Array) -> None:
        """Put the vertices elsewhere, ``[V, 3]``."""
        colours = self._scan.colours
        if not self._scan.has_colour:
            normals = vertex_normals(points.astype(np.float32), self._scan.faces)
            slope = 0.62 + 0.30 * normals @ [0.35, 0.45, 0.82]
            colours = np.clip(slope, 0.05, 1)[:, None] * [0.95, 0.78, 0.70]
        self._places.write(points.astype("f4").tobytes())
        self._colours.write(colours.astype("f4").tobytes())

    def draw(self, camera: Camera, near_m: float = 0.05, far_m: float = 6.0) -> View:
        """What a camera sees of it."""
        c, size = self._context, (camera.width, camera.height)
        if self._target is None or self._target.size != size:
            targets = [c.texture(size, 3), c.texture(size, 1, dtype="f4")]
            self._target = c.framebuffer(targets, c.depth_renderbuffer(size))
        self._target.use()
        self._target.clear(BACKGROUND, BACKGROUND, BACKGROUND)
        c.enable_only(moderngl.DEPTH_TEST)
        clip = camera.clip_from_world(near_m, far_m)
        self._program["clip_from_world"].write(np.ascontiguousarray(clip.T).tobytes())
        self._program["depth_plane"].value = (*camera.rotation[2], camera.translation_m[2])
        self._image.use(0)
        self._mesh.render()
        colour = np.frombuffer(self._target.read(components=3, alignment=1), np.uint8)
        depth = np.frombuffer(self._target.read(components=1, attachment=1, dtype="f4"), np.float32)
        height, width = camera.height, camera.width
        depth_m = depth.reshape(height, width)[::-1].copy()
        depth_m[depth_m == np.float32(BACKGROUND)] = 0.0
        return View(image=colour.reshape(height, width, 3)[::-1].copy(), depth_m=depth_m)
