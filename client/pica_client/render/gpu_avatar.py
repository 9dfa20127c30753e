"""What the GPU holds of an avatar: its meshes, encodings and program, and of a head its maps.

What does not change with the face has a texture, made when an avatar comes: the mesh at rest is
laid out flat by its UVs, and the avatar's own pixel decoder colours each texel as a pixel of the
still face. So nothing of it stands in the file, and none can disagree with what is decoded beside
it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import moderngl
import numpy as np
import numpy.typing as npt

from pica_client.render.gpu_program import (
    AXIS_ROW,
    UNIT_EXPRESSION,
    UNIT_STILL,
    UNIT_U_ENCODING,
    UNIT_UV_ENCODING,
    UNIT_V_ENCODING,
    UNIT_VISIBLE_UV,
    UNIT_VISIBLE_XYZ,
    axis_levels,
    build_program,
    clamp,
    compose,
    set_values,
)
from pica_client.render.gpu_tables import pack_weights, siren_source
from pica_core.avatar.bust import (
    WHOLE_M,
    box_corners,
    bust_of,
    fade_heights_m,
    outline_of,
    seen_faces,
)
from pica_core.avatar.file import Avatar
from pica_core.avatar.levels import SEAM, parts_of, sheet_uv
from pica_core.avatar.spec import EXPRESSION_CHANNELS, POSITION_CHANNELS
from pica_core.errors import ShapeError
from pica_core.reference import still_map
from pica_core.sampling import order_faces
from pica_core.types import Array, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class MeshPrograms:
    """The programs that draw meshes, the same for all avatars."""

    surface: moderngl.Program
    """The surface pass."""
    static: moderngl.Program
    """Draws what does not change with the face."""
    unwrap: moderngl.Program
    """Lays a mesh out flat by its UVs."""


WeightsPlace = Literal["block", "turns"]

BOUNDS_MARGIN_M = 0.01
"""Positions may leave the bounds of the file by this much; the rest is cut off."""
SLACK_M = 0.025
"""Expressions widen the outline of a head by no more: what they move far, as a chin, lies before
what does not move (measured: 12 mm beyond the mean face at most, over a range of motion)."""
TEXTURE_PX = 1024
"""Side of the texture (measured on heads at 18 to 200 cm: MSE 0.3 to 0.6 against decoded pixels; at
512 it is 0.4 to 0.8, for 22 of 169 ms less when an avatar comes). It is looked up bilinearly: three
mip levels cost 1 ms of an image of 2.4, and leave more error, in stills and in what changes as a
head moves."""
MARGIN_PX = 8
"""So far beside its charts a texture has their colours."""

POSITIONS, EXPRESSIONS = 0, 1
"""The two kinds of maps."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """The triangles of one level."""

    decoded: moderngl.VertexArray | None
    """For the surface pass; None where nothing is decoded."""
    static: moderngl.VertexArray | None
    """What has a texture, if something has."""
    num_triangles: int
    """Those of the static part included."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """What all seats with the same avatar share; without a decoder it is all skin."""

    meshes: dict[int, Mesh]
    """Meshes keyed by level; 0 where nothing is decoded."""
    low_m: tuple[float, ...]
    high_m: tuple[float, ...]
    outline_m: FloatArray
    """Points that hold all that is drawn of it between them, ``[K, 3]``."""
    fade_m: tuple[float, float]
    """Heights below which nothing and above which all of it is seen, head frame."""
    skin: moderngl.Texture | None
    """What its static parts look like; None where it has none."""
    shade: moderngl.VertexArray | None = None
    """A rectangle of the screen, drawn by the program of the second pass."""
    textures: dict[int, moderngl.Texture] = field(default_factory=dict)
    """Textures keyed by texture unit."""
    weights: moderngl.Buffer | None = None
    """Bound to uniform block 0; None if the program holds them as constants."""
    still_size: int = 0
    """Expression maps with fewer columns are added to its still map; 0 where it has none."""

    def bind(self) -> None:
        """Make its textures and weights current."""
        for unit, texture in self.textures.items():
            texture.use(unit)
        if self.weights is not None:
            self.weights.bind_to_uniform_block(0)


class HeadMaps:
    """Decoded positions and expressions of one head, by level: uploaded, or drawn by a decoder in
    shaders.

    Args:
        rows: Of its position maps, by level. A level is the columns of both maps, and the rows of
            expression maps.

    Attributes:
        level: That of the maps that came last; 0 before both are there.

    32-bit floats: converting a map to 16 bits on the CPU takes 0.4 ms, uploading it as it is 0.02
    ms (llvmpipe).
    """

    def __init__(self, context: moderngl.Context, rows: Mapping[int, int]) -> None:
        self._context = context
        self._shapes = (
            {level: (count, level, POSITION_CHANNELS) for level, count in rows.items()},
            {level: (level, level, EXPRESSION_CHANNELS) for level in rows},
        )
        self._textures: dict[tuple[int, int], moderngl.Texture] = {}
        self._targets: dict[tuple[int, int], moderngl.Framebuffer] = {}
        self.level = 0

    @property
    def newest(self) -> tuple[moderngl.Texture, moderngl.Texture]:
        """Positions and expressions of `level`."""
        return self._textures[self.level, POSITIONS], self._textures[self.level, EXPRESSIONS]

    def write(self, *arrays: FloatArray | None) -> None:
        """Upload positions and expressions of one level, or one of the two.

        Raises:
            ShapeError: What is not float32, or of no level's shape; nothing is changed.
        """
        for shapes, array in zip(self._shapes, arrays, strict=True):
            if array is None or (array.shape in shapes.values() and array.dtype == np.float32):
                continue
            known = ", ".join(map(str, shapes.values()))
            raise ShapeError(f"map is {array.dtype} {array.shape}; float32 {known} is needed")
        for kind, array in enumerate(arrays):
            if array is not None:
                _, level, components = array.shape
                texture = self._texture(level, kind, components)
                texture.write(np.ascontiguousarray(array))
                self._show(level)

    def target(self, level: int, kind: int) -> moderngl.Framebuffer:
        """Where a map of a level, four channels a texel, is to be drawn now."""
        key = level, kind
        if key not in self._targets:
            self._targets[key] = self._context.framebuffer([self._texture(level, kind, 4)])
        self._show(level)
        return self._targets[key]

    def _texture(self, level: int, kind: int, components: int) -> moderngl.Texture:
        key = level, kind
        if key not in self._textures:
            size = level, self._shapes[kind][level][0]
            texture = self._context.texture(size, components, dtype="f4")
            # Positions are looked up by texelFetch.
            clamp(texture, moderngl.NEAREST if kind == POSITIONS else moderngl.LINEAR)
            self._textures[key] = texture
        return self._textures[key]

    def _show(self, level: int) -> None:
        """Take a level as the newest if both of its maps are there."""
        if {(level, POSITIONS), (level, EXPRESSIONS)} <= set(self._textures):
            self.level = level


def upload_avatar(
    context: moderngl.Context,
    mesh_programs: MeshPrograms,
    avatar: Avatar,
    weights_place: WeightsPlace,
    *,
    filtered: bool = True,
    fades: bool = False,
    program: moderngl.Program | None = None,
) -> Body:
    """Put everything of an avatar but its two decoded maps on the GPU.

    Args:
        weights_place: See `RenderOptions`.
        filtered: Encodings are averaged over what a pixel covers.
        fades: It fades out towards its lower border.
        program: Of another avatar of the same spec and variant; weights in a block only.

    Raises:
        ShaderError: Sizes that the shader does not hold, or a driver that refuses it.
    """
    tensors, manifest = avatar.tensors, avatar.manifest
    if program is None:
        baked = None if weights_place == "block" else tensors
        siren = siren_source(avatar.spec, baked)
        fragment = compose(
            "pixel_decoder.frag",
            avatar.spec,
            generated={"siren.glsl": siren},
            defines={"FILTERED": ""} if filtered else {},
        )
        program = build_program(context, compose("rect.vert"), fragment)
    textures: dict[int, moderngl.Texture] = {}
    if "uv_encoding" in tensors:
        encoding = tensors["uv_encoding"]
        textures[UNIT_UV_ENCODING] = _encoding_texture(context, encoding, filtered)
    for unit, name in ((UNIT_U_ENCODING, "u_encoding"), (UNIT_V_ENCODING, "v_encoding")):
        if name in tensors:
            textures[unit] = _axis_texture(context, tensors[name])
    still = still_map(avatar)
    if still is not None:
        size = (len(still), len(still))
        texture = context.texture(size, still.shape[2], still.tobytes(), dtype="f4")
        textures[UNIT_STILL] = clamp(texture)
    weights = None
    if weights_place == "block":
        matrices, biases = pack_weights(avatar.spec, tensors)
        weights = context.buffer(matrices.tobytes() + biases.tobytes())
    fade_m = fade_heights_m(bust_of(avatar).lower_m) if fades else WHOLE_M
    low_m, high_m = np.array([manifest.bounds_min_m, manifest.bounds_max_m])
    shade = context.vertex_array(program, [])
    body = Body(
        meshes=_level_meshes(context, mesh_programs, avatar, fade_m[0]),
        shade=shade,
        textures=textures,
        weights=weights,
        skin=None,
        low_m=tuple((low_m - BOUNDS_MARGIN_M).tolist()),
        high_m=tuple((high_m + BOUNDS_MARGIN_M).tolist()),
        outline_m=_outline_m(avatar, fade_m[0]),
        still_size=0 if still is None else len(still),
        fade_m=fade_m,
    )
    if still is None or not len(avatar.textured_faces(avatar.levels[-1])):
        return body
    return replace(body, skin=_bake_texture(context, mesh_programs.unwrap, body, shade, avatar))


def _level_meshes(
    context: moderngl.Context, programs: MeshPrograms, avatar: Avatar, gone_m: float
) -> dict[int, Mesh]:
    """The triangles of each level that do not end below `gone_m`, with the vertices that the level
    uses and no others."""
    vertex_uv, rest_m = avatar.tensors["mesh.vertex_uv"], avatar.mean_vertices_m
    parts = parts_of(avatar.tensors)
    corners = np.zeros((0, 6), np.float32)
    if parts is not None:
        corners = np.concatenate([rest_m, vertex_uv, (parts > SEAM)[:, None]], axis=1)
    meshes: dict[int, Mesh] = {}
    for level in avatar.levels:
        # Neighbours together: in the order of a shuffled file five heads take half as long again to
        # draw.
        ordered = order_faces(avatar.decoded_faces(level), vertex_uv)
        static, own = None, order_faces(avatar.textured_faces(level), vertex_uv)
        if len(own):
            own = seen_faces(own, rest_m, gone_m)
            static = static_vertices(context, programs.static, own, corners, "3f 2f 1f")
        used, renumbered = np.unique(ordered, return_inverse=True)
        places = uv = vertex_uv[used]
        faces = seen_faces(renumbered.reshape(-1, 3), rest_m[used], gone_m)
        indices = context.buffer(np.ascontiguousarray(faces, np.int32).tobytes())
        listed = avatar.sheet_vertices(level)
        if listed is not None:
            places = sheet_uv(len(listed), level)[np.searchsorted(listed, used)]
        both = np.ascontiguousarray(np.concatenate([places, uv], axis=1), np.float32)
        content = [(context.buffer(both.tobytes()), "2f 2f", "vertex_place", "vertex_uv")]
        decoded = context.vertex_array(programs.surface, content, index_buffer=indices)
        meshes[level] = Mesh(decoded, static, len(faces) + len(own))
    return meshes


def _outline_m(avatar: Avatar, gone_m: float) -> FloatArray:
    """Points that hold what is seen of an avatar between them: the box that it has promised to stay
    in, or, where parts of it do not change, those as they are and the others wherever expressions
    take them."""
    rest_m, full, manifest = avatar.mean_vertices_m, avatar.levels[-1], avatar.manifest
    low_m, high_m = np.array([manifest.bounds_min_m, manifest.bounds_max_m])
    still, moving = (
        rest_m[np.unique(seen_faces(faces, rest_m, gone_m))]
        for faces in (avatar.textured_faces(full), avatar.decoded_faces(full))
    )
    if not len(still):
        return outline_of(box_corners(low_m - BOUNDS_MARGIN_M, high_m + BOUNDS_MARGIN_M))
    outline_m = outline_of(np.concatenate([still, outline_of(moving, SLACK_M)]))
    outline_m[:, 1] = np.maximum(outline_m[:, 1], gone_m)
    return np.clip(outline_m, low_m, high_m).astype(np.float32)


def _bake_texture(
    context: moderngl.Context,
    unwrap: moderngl.Program,
    body: Body,
    shade: moderngl.VertexArray,
    avatar: Avatar,
) -> moderngl.Texture:
    """Colour the still face wherever it has a texture, by the pixel decoder of its body."""
    size = (TEXTURE_PX, TEXTURE_PX)
    xyz, uv = context.texture(size, 4, dtype="f4"), context.texture(size, 2, dtype="nu2")
    depth = context.depth_renderbuffer(size)
    texture = clamp(context.texture(size, 4))
    surface = context.framebuffer([xyz, uv], depth)
    coloured = context.framebuffer([texture], depth)
    rest_m, vertex_uv = avatar.mean_vertices_m, avatar.tensors["mesh.vertex_uv"]
    corners = np.concatenate([rest_m, vertex_uv], axis=1)
    faces = avatar.textured_faces(avatar.levels[-1])
    flat = static_vertices(context, unwrap, faces, corners, "3f 2f")

    context.enable_only(moderngl.DEPTH_TEST)
    context.depth_func = "<"
    coloured.clear()
    surface.use()
    surface.clear(depth=1.0)
    set_values(unwrap, margin=MARGIN_PX / TEXTURE_PX)
    flat.render(instances=9)

    body.bind()
    body.textures[UNIT_STILL].use(UNIT_EXPRESSION)
    xyz.use(UNIT_VISIBLE_XYZ)
    uv.use(UNIT_VISIBLE_UV)
    coloured.use()
    coloured.depth_mask = False
    context.depth_func = ">"
    set_values(shade.program, is_change=False, shown=WHOLE_M)
    shade.render(moderngl.TRIANGLE_STRIP, vertices=4)
    context.depth_func = "<"
    context.detect_framebuffer(0).use()  # those of here are freed
    return texture


def static_vertices(
    context: moderngl.Context, program: moderngl.Program, faces: Array, corners: Array, layout: str
) -> moderngl.VertexArray:
    """Triangles ``[F, 3]`` over those of the corners ``[V, C]`` that they use: places, UVs and,
    where the layout has it, opacities."""
    used, numbers = np.unique(faces, return_inverse=True)
    content = np.ascontiguousarray(corners[used], np.float32).tobytes()
    names = ("vertex_xyz_m", "vertex_uv", "vertex_opacity")[: len(layout.split())]
    return context.vertex_array(
        program,
        [(context.buffer(content), layout, *names)],
        index_buffer=context.buffer(np.ascontiguousarray(numbers, np.int32).tobytes()),
    )


def _encoding_texture(
    context: moderngl.Context, encoding: npt.NDArray[Any], filtered: bool
) -> moderngl.Texture:
    """m_uv ``[T, T, C]`` in 16-bit floats, with its mip levels."""
    half = np.ascontiguousarray(encoding, np.float16)
    texture = context.texture(
        half.shape[1::-1], half.shape[2], half.tobytes(), dtype="f2", alignment=1
    )
    clamp(texture)
    if filtered:
        texture.build_mipmaps()
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    return texture


def axis_table(table: npt.NDArray[Any]) -> FloatArray:
    """What `encodings.glsl` reads: all levels of a table, one after another.

    Args:
        table: ``[L, C]``, C at most 2.

    Returns:
        float32 ``[2 S, 4]``, S the power of two from L on: an entry in the first two, the way to
        the next one in the last two. Level k begins at 2 S - (2 S >> k); each of its entries is the
        mean of 2^k of the table's, the last one of those that are left.
    """
    count, channels = table.shape
    num_levels = axis_levels(count)
    total = 1 << num_levels
    found = np.zeros((total, 4), np.float32)
    sums = np.concatenate([np.zeros((1, channels)), np.cumsum(table, axis=0, dtype=np.float64)])
    for level in range(num_levels):
        edges = np.minimum(np.arange(0, count + (1 << level), 1 << level), count)
        means = np.diff(sums[edges], axis=0) / np.diff(edges)[:, None]
        start = total - (total >> level)
        found[start : start + len(means), :channels] = means
        found[start : start + len(means) - 1, 2 : 2 + channels] = np.diff(means, axis=0)
    return found


def _axis_texture(context: moderngl.Context, table: npt.NDArray[Any]) -> moderngl.Texture:
    """A table ``[L, C]`` and its levels, folded into rows of `AXIS_ROW` texels, 32-bit floats."""
    texels = axis_table(table)
    rows = -(-len(texels) // AXIS_ROW)
    folded = np.zeros((rows * AXIS_ROW, 4), np.float32)
    folded[: len(texels)] = texels
    texture = context.texture((AXIS_ROW, rows), 4, folded.tobytes(), dtype="f4")
    return clamp(texture, moderngl.NEAREST)
