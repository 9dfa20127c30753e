"""The model's skin laid flat: which triangle each texel of a head's texture is on, and what a
camera sees of it."""

from typing import Any, Self

import moderngl
import numpy as np

from pica_core.camera import Camera
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.me.head import TEXTURE_SIZE, chart_uv
from pica_core.capture.person.choices import FaceModel
from pica_core.gl import create_context, link_program
from pica_core.types import BoolArray, Float64Array, FloatArray, Int64Array

FLAT = """#version 330
in vec2 uv;
in vec3 marks;
out vec3 mark;
void main() { mark = marks; gl_Position = vec4(uv * 2.0 - 1.0, 0.0, 1.0); }
"""
MARK = """#version 330
in vec3 mark;
out vec3 mark_out;
void main() { mark_out = mark; }
"""
SOLID = """#version 330
uniform mat4 clip_from_head;
uniform vec4 plane;
in vec3 place;
out float mark;
void main() {
    mark = dot(plane, vec4(place, 1.0));
    gl_Position = clip_from_head * vec4(place, 1.0);
}
"""
DEPTH = """#version 330
in float mark;
out float depth_out;
void main() { depth_out = mark; }
"""


class Unwrapped:
    """The skin of the model on its chart; a context manager, of one thread.

    Attributes:
        seen: Which texels are skin. ``[S, S]``.
        faces: Corners of the triangle of each of these. ``[T, 3]``.
        weights: Where in it each lies. ``[T, 3]``.
    """

    def __init__(self, model: FaceModel, size: int = TEXTURE_SIZE) -> None:
        self._context: Any = create_context()
        mesh = model.mean
        skin = mesh.part == MATERIALS.index("skin")
        corners, uv = mesh.faces[skin], chart_uv(model)[mesh.uv_faces[skin]]
        self.seen, triangle, self.weights = self._lay(uv.reshape(-1, 2), size)
        self.faces: Int64Array = corners[triangle].astype(np.int64)
        self._mesh_faces = np.ascontiguousarray(mesh.faces, "i4")
        self._program: Any = link_program(self._context, vertex=SOLID, fragment=DEPTH)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.gc()
        self._context.release()

    def _lay(self, uv: Float64Array, size: int) -> tuple[BoolArray, Int64Array, Float64Array]:
        c = self._context
        program = link_program(c, vertex=FLAT, fragment=MARK)
        count = len(uv) // 3
        number = np.repeat(np.arange(count) + 1.0, 3)
        ends = np.tile([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], (count, 1))
        data = np.concatenate([uv, number[:, None], ends], 1).astype("f4")
        mesh = c.vertex_array(program, [(c.buffer(data.tobytes()), "2f 3f", "uv", "marks")])
        target = c.framebuffer([c.texture((size, size), 3, dtype="f4")])
        target.use()
        target.clear()
        c.enable_only(moderngl.NOTHING)
        mesh.render()
        marks = np.frombuffer(target.read(components=3, dtype="f4"), np.float32)
        marks = marks.reshape(size, size, 3)
        seen = marks[..., 0] > 0.5
        inside = marks[seen].astype(np.float64)
        weights = np.stack([inside[:, 1], inside[:, 2], 1 - inside[:, 1] - inside[:, 2]], 1)
        return seen, np.rint(inside[:, 0]).astype(np.int64) - 1, weights

    def at(self, values: FloatArray | Float64Array) -> Float64Array:
        """Values of vertices ``[P, ...]`` at the texels. ``[T, ...]``."""
        found: Float64Array = np.einsum("tk,tk...->t...", self.weights, values[self.faces])
        return found

    def depth(self, points: Float64Array, camera: Camera) -> FloatArray:
        """How far the head is at each pixel of a camera, metres; 0 beside it. ``[H, W]``."""
        c = self._context
        places = c.buffer(np.ascontiguousarray(points, "f4").tobytes())
        mesh = c.vertex_array(
            self._program, [(places, "3f", "place")], c.buffer(self._mesh_faces.tobytes())
        )
        size = camera.width, camera.height
        target = c.framebuffer([c.texture(size, 1, dtype="f4")], c.depth_renderbuffer(size))
        target.use()
        target.clear()
        c.enable_only(moderngl.DEPTH_TEST)
        clip = camera.clip_from_world(0.05, 6.0)
        self._program["clip_from_head"].write(np.ascontiguousarray(clip.T).tobytes())
        self._program["plane"].value = (*camera.rotation[2], camera.translation_m[2])
        mesh.render()
        raw = np.frombuffer(target.read(components=1, dtype="f4"), np.float32)
        c.gc()
        return raw.reshape(camera.height, camera.width)[::-1].copy()
