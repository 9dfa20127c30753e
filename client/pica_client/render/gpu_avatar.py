"""What the GPU holds of an avatar: its meshes, encodings and program; and of the head that stands
in for one."""

from dataclasses import dataclass, replace
from typing import Any, Literal

import moderngl
import numpy as np
import numpy.typing as npt

from pica_client.render.gpu_program import (
    UNIT_EXPRESSION,
    UNIT_POSITION,
    UNIT_STILL,
    UNIT_U_ENCODING,
    UNIT_UV_ENCODING,
    UNIT_V_ENCODING,
    build_program,
    clamp,
)
from pica_client.render.gpu_static import bake_texture, static_vertices
from pica_client.render.shader_source import AXIS_ROW, axis_levels, compose
from pica_client.render.shader_weights import pack_weights, siren_source
from pica_core.avatar.bust import (
    WHOLE_M,
    box_corners,
    bust_of,
    fade_heights_m,
    outline_of,
    seen_faces,
)
from pica_core.avatar.file import Avatar
from pica_core.avatar.levels import sheet_uv
from pica_core.avatar.static import SEAM, parts_of
from pica_core.reference.decoders import still_map
from pica_core.sampling import order_faces
from pica_core.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class MeshPrograms:
    """The programs that draw meshes, the same for all avatars."""

    whole: moderngl.Program
    """The surface pass of a head that is drawn whole."""
    sharing: moderngl.Program
    """That of a head that shares pixels with another level of itself."""
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

PLACEHOLDER_GRID = 64
"""Rows and columns of the placeholder's position map."""
PLACEHOLDER_PROFILE_M = (
    # height, half width, half depth, middle of the depth
    (0.138, 0.000, 0.000, 0.000),
    (0.132, 0.031, 0.038, 0.000),
    (0.112, 0.057, 0.070, 0.000),
    (0.075, 0.075, 0.092, 0.000),
    (0.030, 0.080, 0.098, 0.002),
    (-0.020, 0.075, 0.092, 0.006),
    (-0.060, 0.066, 0.080, 0.012),
    (-0.090, 0.053, 0.064, 0.012),
    (-0.104, 0.047, 0.054, 0.002),
    (-0.124, 0.047, 0.050, -0.012),
    (-0.138, 0.062, 0.058, -0.018),
    (-0.150, 0.108, 0.074, -0.022),
    (-0.166, 0.146, 0.086, -0.026),
    (-0.192, 0.167, 0.094, -0.028),
    (-0.230, 0.174, 0.098, -0.028),
    (-0.290, 0.174, 0.098, -0.028),
)
"""A faceless bust, from the crown down (chosen: as large as a person, without a face)."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """The triangles of one level, for the positions of one level."""

    level: int
    vertices: tuple[moderngl.VertexArray, moderngl.VertexArray]
    """Arrays for the surface pass of a head that is drawn whole, and of one that shares pixels."""
    static: moderngl.VertexArray | None
    """What of it does not change with the face, if something does not."""
    num_triangles: int
    """Those of the static part included."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """What all seats with the same avatar share."""

    meshes: dict[tuple[int, int], Mesh]
    """Meshes keyed by the levels of the positions and of the triangles; a placeholder has one."""
    shade: moderngl.VertexArray
    """A rectangle of the screen, drawn by the program of the second pass."""
    textures: dict[int, moderngl.Texture]
    """Textures keyed by texture unit."""
    weights: moderngl.Buffer | None
    """Bound to uniform block 0; None if the program holds them as constants."""
    skin: moderngl.Texture | None
    """What its static parts look like; None where it has none."""
    low_m: tuple[float, ...]
    high_m: tuple[float, ...]
    outline_m: FloatArray
    """Points that hold all that is drawn of it between them, ``[K, 3]``."""
    still_size: int = 0
    """Expression maps with fewer columns are added to its still map; 0 where it has none."""
    fade_m: tuple[float, float] = WHOLE_M
    """Heights below which nothing and above which all of it is seen, head frame."""

    def mesh(self, position_level: int, mesh_level: int | None) -> Mesh:
        """The triangles to draw with positions of a level; the positions' own serve where there is
        no such mesh."""
        own = self.meshes[position_level, position_level]
        return self.meshes.get((position_level, mesh_level or position_level), own)

    def bind(self) -> None:
        """Make its textures and weights current."""
        for unit, texture in self.textures.items():
            texture.use(unit)
        if self.weights is not None:
            self.weights.bind_to_uniform_block(0)


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
            generated={"SIREN": siren},
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
        weights = context.buffer(pack_weights(avatar.spec, tensors))
    fade_m = fade_heights_m(bust_of(avatar).lower_m) if fades else WHOLE_M
    low_m, high_m = np.array([manifest.bounds_min_m, manifest.bounds_max_m])
    body = Body(
        meshes=_level_meshes(context, mesh_programs, avatar, fade_m[0]),
        shade=context.vertex_array(program, []),
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

    def bind_still() -> None:
        body.bind()
        textures[UNIT_STILL].use(UNIT_EXPRESSION)

    skin = bake_texture(context, mesh_programs.unwrap, body.shade, avatar, bind_still)
    return replace(body, skin=skin)


def upload_placeholder(context: moderngl.Context, mesh_programs: MeshPrograms) -> Body:
    """The head that stands in for an avatar that is not there or cannot be used."""
    program = build_program(context, compose("rect.vert"), compose("placeholder.frag"))
    count, bust = PLACEHOLDER_GRID, placeholder_map()
    corner = np.arange(count * count, dtype=np.int32).reshape(count, count)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    faces = np.stack([a, c, b, b, c, d], axis=-1).reshape(-1, 3)
    # Texel centres, so that the mesh closes exactly on the map's border texels.
    texel = (np.arange(count, dtype=np.float32) + 0.5) / count
    vertex_uv = np.stack(np.meshgrid(texel, texel), axis=-1).reshape(-1, 2)
    texture = context.texture((count, count), 3, bust.tobytes(), dtype="f4")
    low_m, high_m = bust.min(axis=(0, 1)), bust.max(axis=(0, 1))
    return Body(
        meshes={(0, 0): upload_mesh(context, mesh_programs, 0, faces, vertex_uv, vertex_uv)},
        shade=context.vertex_array(program, []),
        textures={UNIT_POSITION: clamp(texture)},
        weights=None,
        skin=None,
        low_m=tuple(low_m.tolist()),
        high_m=tuple(high_m.tolist()),
        outline_m=outline_of(bust.reshape(-1, 3)),
        fade_m=fade_heights_m(float(low_m[1])),
    )


def _level_meshes(
    context: moderngl.Context, programs: MeshPrograms, avatar: Avatar, gone_m: float
) -> dict[tuple[int, int], Mesh]:
    """The triangles of each level that do not end below `gone_m`, with the vertices that the level
    uses and no others: for the full positions, and for the level's own."""
    vertex_uv, rest_m = avatar.tensors["mesh.vertex_uv"], avatar.mean_vertices_m
    full, parts = avatar.levels[-1], parts_of(avatar.tensors)
    corners = np.zeros((0, 6), np.float32)
    if parts is not None:
        corners = np.concatenate([rest_m, vertex_uv, (parts > SEAM)[:, None]], axis=1)
    meshes = {}
    for level in avatar.levels:
        # Neighbours together: in the order of a shuffled file five heads take half as long again to
        # draw.
        ordered = order_faces(avatar.decoded_faces(level), vertex_uv)
        static, own = None, order_faces(avatar.textured_faces(level), vertex_uv)
        if len(own):
            own = seen_faces(own, rest_m, gone_m)
            static = static_vertices(context, programs.static, own, corners, "3f 2f 1f")
        used, renumbered = np.unique(ordered, return_inverse=True)
        uv = vertex_uv[used]
        faces = seen_faces(renumbered.reshape(-1, 3), rest_m[used], gone_m)
        sheet = avatar.sheet_vertices(full)
        at_full = uv if sheet is None else sheet_uv(len(sheet), full)[used]
        meshes[full, level] = upload_mesh(
            context, programs, level, faces, uv, at_full, static, len(own)
        )
        if level != full:
            listed = avatar.sheet_vertices(level)
            assert listed is not None  # below the full one
            places = sheet_uv(len(listed), level)[np.searchsorted(listed, used)]
            meshes[level, level] = upload_mesh(
                context, programs, level, faces, uv, places, static, len(own)
            )
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


def upload_mesh(
    context: moderngl.Context,
    programs: MeshPrograms,
    level: int,
    faces: npt.NDArray[Any],
    vertex_uv: npt.NDArray[Any],
    places: npt.NDArray[Any],
    static: moderngl.VertexArray | None = None,
    num_static: int = 0,
) -> Mesh:
    """Put triangles ``[F, 3]`` on the GPU, with the places ``[V, 2]`` at which positions of their
    vertices are looked up; static ones belong to the mesh, too."""
    indices = context.buffer(np.ascontiguousarray(faces, np.int32).tobytes())
    both = np.concatenate([places, vertex_uv], axis=1)
    corners = context.buffer(np.ascontiguousarray(both, np.float32).tobytes())
    content = [(corners, "2f 2f", "vertex_place", "vertex_uv")]
    whole, sharing = (
        context.vertex_array(program, content, index_buffer=indices)
        for program in (programs.whole, programs.sharing)
    )
    return Mesh(level, (whole, sharing), static, len(faces) + num_static)


def placeholder_map() -> FloatArray:
    """The faceless bust as a position map, columns around +y and rows from the crown down: the
    profile at even steps along itself, its corners rounded. float32 ``[S, S, 3]``."""
    profile = np.array(PLACEHOLDER_PROFILE_M)
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(profile[:, :3], axis=0), axis=1))])
    steps = np.linspace(0, way[-1], PLACEHOLDER_GRID)
    rows = np.stack([np.interp(steps, way, column) for column in profile.T], axis=1)
    for _ in range(3):
        rows[1:-1] = 0.25 * rows[:-2] + 0.5 * rows[1:-1] + 0.25 * rows[2:]
    height, wide, deep, middle = (column[:, None] for column in rows.T)
    turn = np.linspace(-np.pi, np.pi, PLACEHOLDER_GRID)
    around = [wide * np.sin(turn), height + 0 * turn, middle + deep * np.cos(turn)]
    bust: FloatArray = np.ascontiguousarray(np.stack(around, axis=-1), np.float32)
    return bust


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
    """What `axis_table.glsl` reads: all levels of a table, one after another.

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
