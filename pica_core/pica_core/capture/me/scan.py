"""A scan as its file has it: one mesh with its colours, from a GLB, OBJ or PLY file; and pictures
of it without light, what networks find faces in: light on skin is in its texture already.

trimesh reads the files (compressed GLB files by DracoPy). What comes from a phone or a stranger is
checked here: every problem is a `CaptureError` with the file and a remedy.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import moderngl
import numpy as np
import trimesh
from PIL import Image

from pica_core.camera import Camera
from pica_core.capture.rig.source import open_image
from pica_core.capture.stage.subject import View
from pica_core.capture.triangles import vertex_normals
from pica_core.errors import CaptureError
from pica_core.gl import create_context, link_program
from pica_core.types import ByteArray, Float64Array, IntArray

KINDS = (".glb", ".gltf", ".obj", ".ply")
MAX_BYTES = 800_000_000
LEAST_TRIANGLES, MOST_TRIANGLES = 2_000, 3_000_000
MAX_SIDE = 8192
"""Longest side of a texture, pixels; larger ones are made smaller."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Scan:
    """A scan in the units and axes of its file.

    Attributes:
        points: ``[V, 3]``.
        faces: ``[F, 3]``.
        uv: Texture coordinates, v downwards; 0 where there is no image. ``[V, 2]``.
        image: Its texture, sRGB. uint8 ``[H, W, 3]``; one white pixel if there is none.
        colours: What the image is multiplied with, 0 to 1. ``[V, 3]``.
        has_colour: False: neither an image nor colours of vertices.
        has_loose_image: The image was named beside the file.
    """

    path: Path
    points: Float64Array
    faces: IntArray
    uv: Float64Array
    image: ByteArray
    colours: Float64Array
    has_colour: bool
    has_loose_image: bool


def read_scan(path: Path, texture: Path | None = None) -> Scan:
    """Read a scan.

    Args:
        path: A .glb, .gltf, .obj or .ply file.
        texture: An image that goes before the file's own.

    Raises:
        CaptureError: It cannot be read, or is no scan of a head; names file and remedy.
    """
    mesh = _load(path)
    count = len(mesh.faces)
    if count > MOST_TRIANGLES:
        raise CaptureError(
            f"{path}: {count:,} triangles; up to {MOST_TRIANGLES:,} are read: export fewer, or "
            "reduce it with Blender's Decimate"
        )
    if count < LEAST_TRIANGLES:
        raise CaptureError(
            f"{path}: {count:,} triangles; a scan of a head has at least {LEAST_TRIANGLES:,}"
        )
    points = np.asarray(mesh.vertices, np.float64)
    if not np.isfinite(points).all() or not np.ptp(points, axis=0).min() > 0:
        raise CaptureError(f"{path}: places of vertices are not finite, or flat; export it again")
    uv = getattr(mesh.visual, "uv", None)
    image, colours = _appearance(mesh), np.ones((len(points), 3))
    if texture is not None:
        if uv is None:
            raise CaptureError(f"{path}: no texture coordinates; leave out --texture {texture}")
        image = open_image(str(texture), texture.read_bytes())[..., :3]
    elif image is None and getattr(mesh.visual, "kind", None) == "vertex":
        colours = np.asarray(mesh.visual.vertex_colors, np.float64)[:, :3] / 255
    has_image = image is not None and uv is not None
    placed = np.zeros((len(points), 2))
    if has_image:
        placed = np.asarray(uv, np.float64) * [1, -1] + [0, 1]  # trimesh counts v upwards
    return Scan(
        path=path,
        points=points,
        faces=np.asarray(mesh.faces, np.int32),
        uv=placed,
        image=image if has_image and image is not None else np.full((1, 1, 3), 255, np.uint8),
        colours=colours,
        has_colour=has_image or bool(np.ptp(colours) > 0),
        has_loose_image=texture is not None,
    )


def _load(path: Path) -> Any:
    """The triangles of a file as one mesh of trimesh's."""
    if path.suffix.lower() not in KINDS:
        raise CaptureError(f"{path}: a scan is one of {', '.join(KINDS)}; export it as GLB")
    try:
        if path.stat().st_size > MAX_BYTES:
            raise CaptureError(
                f"{path}: {path.stat().st_size / 1e6:.0f} MB; up to {MAX_BYTES / 1e6:.0f} MB are "
                "read: export fewer triangles"
            )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = trimesh.load_scene(path)
            mesh = scene.to_mesh() if scene.geometry else None
    except CaptureError:
        raise
    except OSError as error:
        raise CaptureError(f"{path}: {error.strerror or error}") from error
    except Exception as error:  # readers of so many formats have errors of all kinds
        what = f"{type(error).__name__}: {error}"
        raise CaptureError(f"{path}: cannot be read ({what}); export it as GLB") from error
    if mesh is None or not len(getattr(mesh, "faces", ())):
        raise CaptureError(f"{path}: no triangles; export a mesh, not a cloud of points")
    return mesh


def _appearance(mesh: Any) -> ByteArray | None:
    """The image of a mesh's material."""
    material = getattr(mesh.visual, "material", None)
    found = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if not isinstance(found, Image.Image):
        return None
    if max(found.size) > MAX_SIDE:
        found.thumbnail((MAX_SIDE, MAX_SIDE))
    return np.asarray(found.convert("RGB"))


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
