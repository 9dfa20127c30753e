"""Hair of a person: a cap that the scalp itself is raised to, and what hangs from it.

An avatar's mesh is opaque and of one topology, so hair is two things: the scalp's own vertices are
moved outwards, with a soft painted edge, for nothing can then cut through the face; and long hair
is a closed sheet of rings, laid outside of head, ears, neck and clothes. Strands are
painted along both. Lengths are metres in the head frame; azimuth 0 is the front.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pica_core.capture.triangles import nearest
from pica_core.files import packaged_json
from pica_core.types import BoolArray, Float64Array, IntArray

LOOKS = packaged_json("pica_core.capture.person", "looks.json")
"""What people may choose from; colours are linear."""
HAIRLINE = np.array(LOOKS["hairline"]).T
"""Azimuths in degrees, and the height over each."""
EDGE_M = 0.014
"""What coverage of 1 is, above the hairline."""
EAR_ROOM_M = (0.002, 0.010)
"""Distance to an ear within which coverage fades away."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Style:
    """A way to wear hair; lengths are millimetres."""

    cap: float = 0.0
    """How far the scalp is raised, at most."""
    rise: float = 1.6
    """Coverage at which the cap has its full height."""
    sides: float = 0.5
    """Height of the cap at the sides, against the top."""
    quiff: float = 0.0
    """How much more the cap is raised over the forehead."""
    flow: Sequence[float] = (0.0, -1.0, 0.0)
    """Where strands lie to; what follows from `parting` and `radial` is added."""
    parting: float | None = None
    """Place of a parting, mm to the subject's left: strands lie away from it."""
    radial: bool = False
    """Strands stand away from the scalp."""
    clumps: float = 1.0
    """Unevenness of the cap."""
    curl: float = 0.0
    """Height of the lumps that curls make."""
    recession: float = 0.0
    """How far the hairline has withdrawn over temples and forehead."""
    hang: float = 0.0
    """Height of the lower end of hair that hangs, below the ears."""
    wave: float = 2.0
    """Depth of the waves of hair that hangs."""


STYLES = {name: Style(**numbers) for name, numbers in LOOKS["styles"].items()}
COLUMNS, ROWS = 48, 28
FRONT_DEG = np.array(LOOKS["front_deg"]).T
"""Heights, and the azimuth of the front edges of hair that hangs at each: it parts above the
forehead and frames the face."""
CLEAR_M, THICK_M = 0.003, 0.009
"""Distance of hair that hangs from what is under it, and its thickness."""
INNER_SHARE = 0.25
"""Width of the inner side of hanging hair on the chart, against the outer one's."""
CROWN_M = 0.016
"""How far below the crown hanging hair leaves the cap."""
SHOULDER_M = 0.100
"""Where shoulders begin: hair that hangs at the sides ends there."""
INWARDS = 0.30
"""How far hair falls inwards below the widest place, per unit of height."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Surface:
    """What is added to a head.

    Attributes:
        points: ``[n, 3]``.
        faces: ``[F, 3]``.
        uv: Of corners that `uv_faces` names, metres: round the surface, down it. ``[T, 2]``.
        uv_faces: ``[F, 3]``.
    """

    points: Float64Array
    faces: IntArray
    uv: Float64Array
    uv_faces: IntArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sheet:
    """A closed sheet of hair.

    Attributes:
        strand: Along 0 to 1, across -1 to 1, number, length in metres. ``[n, 4]``.
        tangent: Direction of its strands. ``[n, 3]``.
        root: Vertex of the head that it moves with.
    """

    surface: Surface
    strand: Float64Array
    tangent: Float64Array
    root: int


def cover(points: Float64Array, skin: BoolArray, ears: BoolArray, style: Style) -> Float64Array:
    """Height of each point above the hairline, in `EDGE_M`; below 0 outside. ``[P]``."""
    if not style.cap:
        return np.full(len(points), -1.0)
    azimuth = np.degrees(np.abs(np.arctan2(points[:, 0], points[:, 2] + 0.005)))
    line = np.interp(azimuth, *HAIRLINE)
    back = style.recession / 1000 * (
        np.exp(-0.5 * ((azimuth - 36) / 13) ** 2) + 0.35 * np.exp(-0.5 * (azimuth / 18) ** 2)
    )  # fmt: skip
    ragged = 0.0030 * lumps(points, 0.022, 11) + 0.0015 * lumps(points, 0.009, 12)
    high = (points[:, 1] - line - back) / EDGE_M
    if not style.radial:  # where hair rises steeply, an uneven line would fold it
        high -= ragged / EDGE_M * np.exp(-(np.maximum(high, 0.0) ** 2))
    # Over the forehead height says little of distance: the surface leans back.
    coverage = np.where(skin, np.clip(high, -1.0, 6.0), -1.0)
    if ears.any():
        near = np.flatnonzero(skin & ~ears & (np.abs(azimuth - 90) < 50) & (points[:, 1] < 0.07))
        _, apart = nearest(points[near], points[ears])
        room = (apart - EAR_ROOM_M[0]) / (EAR_ROOM_M[1] - EAR_ROOM_M[0])
        coverage[near] = np.minimum(coverage[near], 2.2 * room - 0.8)
        coverage[ears] = -1.0
    return coverage


def smooth(value: Float64Array) -> Float64Array:
    """0 below 0, 1 above 1, smooth between."""
    t = np.clip(value, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def lumps(points: Float64Array, size_m: float, seed: int) -> Float64Array:
    """Smooth noise of about unit deviation, with features of `size_m`. ``[P]``."""
    random = np.random.default_rng([seed, 0x1095])
    waves = random.normal(size=(24, 3)) * 2.2 / size_m
    phase = random.uniform(0, 2 * np.pi, 24)
    return np.sin(points @ waves.T + phase).sum(1) / np.sqrt(12)


def flow(points: Float64Array, normals: Float64Array, style: Style) -> Float64Array:
    """Direction of strands over the head, unit length, along the surface. ``[P, 3]``."""
    way = np.broadcast_to(np.array(style.flow), points.shape).copy()
    if style.parting is not None:
        side = np.tanh((points[:, 0] - style.parting / 1000) / 0.008)
        way[:, 0] += 1.3 * side * smooth((points[:, 1] - 0.02) / 0.08)
    elif style.radial:
        way = points - [0.0, 0.13, -0.02]
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    way -= normals * (way * normals).sum(1, keepdims=True)
    amount, size = (0.6, 0.012) if style.curl else (0.12, 0.03)  # curls break the highlight
    way += amount * np.stack([lumps(points, size, k) for k in range(3)], 1)
    return way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)


def raise_cap(
    points: Float64Array, normals: Float64Array, coverage: Float64Array, style: Style, seed: int
) -> Float64Array:
    """Where the scalp's vertices go. ``[P, 3]``."""
    thick = style.cap / 1000 * smooth(coverage / style.rise)
    # Sides and nape are shorter than the top, and a forelock is longer.
    top = style.sides + (1 - style.sides) * smooth((points[:, 1] - 0.03) / 0.06)
    fore = smooth((points[:, 2] - 0.02) / 0.06) * smooth((points[:, 1] - 0.06) / 0.04)
    thick = thick * top + style.quiff / 1000 * fore * smooth(coverage / style.rise)
    # Clumps run along the strands: noise that is drawn out along them.
    way = flow(points, normals, replace(style, curl=0.0))
    drawn = sum(lumps(points + way * k, 0.011, seed) for k in (-0.012, -0.006, 0.0, 0.006, 0.012))
    thick = thick * (1 + 0.055 * style.clumps * drawn)
    if style.parting is not None:
        gap = np.exp(-0.5 * ((points[:, 0] - style.parting / 1000) / 0.004) ** 2)
        thick = thick * (1 - 0.6 * gap * smooth((points[:, 1] - 0.05) / 0.03))
    if style.curl:
        bumps = lumps(points, 0.012, seed + 1)
        thick += 0.001 * style.curl * bumps * smooth(coverage / style.rise)
    if style.radial:  # from a point inside the head: nothing crosses
        normals = points - [0.0, 0.03, -0.015]
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return points + normals * np.maximum(thick, 0.0)[:, None]


def join_rings(rings: Float64Array, u: Float64Array) -> Surface:
    """Join rings ``[R, C, 3]``, one below the other; `u` goes round them, metres. ``[C + 1]``."""
    rows, columns = rings.shape[:2]
    found = []
    for wide in (columns, columns + 1):
        first = (np.arange(rows - 1) * wide)[:, None] + np.arange(columns)
        after = first + 1
        if wide == columns:
            after[:, -1] -= columns
        corners = (first, first + wide, after, after, first + wide, after + wide)
        found.append(np.stack(corners, -1).reshape(-1, 3).astype(np.int32))
    steps = np.linalg.norm(np.diff(rings, axis=0), axis=2).mean(1)
    v = np.concatenate([[0], np.cumsum(steps)])
    uv = np.stack(np.broadcast_arrays(u[None], v[:, None]), -1).reshape(-1, 2)
    return Surface(points=rings.reshape(-1, 3), faces=found[0], uv=uv, uv_faces=found[1])


def grow(points: Float64Array, style: Style, seed: int, body: Float64Array) -> Sheet | None:
    """What hangs from a raised scalp ``[P, 3]``, outside of a body ``[n, 3]``, or nothing."""
    if not style.hang:
        return None
    rings = _curtain(points, style, seed, body)
    around = np.linalg.norm(np.diff(rings, axis=1, append=rings[:, :1]), axis=2).mean(0)
    around[len(around) // 2 :] *= INNER_SHARE  # the inner half is seldom seen
    surface = join_rings(rings, np.concatenate([[0], np.cumsum(around)]))
    columns = rings.shape[1]
    v = surface.uv[:: columns + 1, 1]
    strand = np.zeros((len(surface.points), 4))
    strand[:, 0] = np.repeat(v / v[-1], columns)
    strand[:, 3] = v[-1]
    tangent = np.gradient(rings, axis=0).reshape(-1, 3)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    root = int(np.argmax(points[:, 1]))
    return Sheet(surface=surface, strand=strand, tangent=tangent, root=root)


def _curtain(points: Float64Array, style: Style, seed: int, body: Float64Array) -> Float64Array:
    """Hair from over the ears down, round the back. ``[ROWS, 2 COLUMNS, 3]``."""
    t = np.linspace(0.0, 1.0, ROWS)
    s = np.linspace(-1.0, 1.0, COLUMNS)
    crown = float(points[:, 1].max()) - CROWN_M
    uneven = 0.006 * lumps(np.stack([0.4 * s, 0 * s, 0 * s], 1), 0.05, seed + 5)
    uneven += 0.003 * lumps(np.stack([0.4 * s, 0 * s, 0 * s], 1), 0.012, seed + 9)  # locks
    low = -style.hang / 1000 + uneven + 0.012 * np.abs(s) ** 3
    # Hair ends on the shoulders where they begin, and goes on down the back.
    for y in np.arange(-0.06, low.min(), -0.006):
        level = np.full(COLUMNS, y)
        wide = _reach(body, _azimuth(s, level), level) > SHOULDER_M
        low = np.where(wide, np.maximum(low, y + 0.008), low)
    for _ in range(3):
        padded = np.pad(low, 1, mode="edge")
        low = np.maximum(low, 0.25 * padded[:-2] + 0.5 * low + 0.25 * padded[2:])
    y = crown + (low - crown) * t[:, None]
    angle = _azimuth(s, y)
    # Where the head leans back the widest place near a height lies below it.
    steep = 0.008 * smooth((y - 0.07) / 0.04)
    reach = np.stack([_reach(body, *each) for each in zip(angle, y + steep, strict=True)])
    centre = np.minimum(1.0, 8 * (1 - np.abs(s)))  # the front edges lie close to the skin
    for _ in range(3):
        padded = np.pad(reach, ((1, 1), (1, 1)), mode="edge")
        mean = 0.25 * (padded[1:-1, :-2] + padded[1:-1, 2:] + padded[:-2, 1:-1] + padded[2:, 1:-1])
        reach = np.maximum(reach, centre * mean + (1 - centre) * reach)
    full = smooth((crown - y) / 0.030)
    edge = np.minimum(1.0, (1 - np.abs(s)) * 6 + 0.10)
    inner = reach - 0.006 + (0.006 + CLEAR_M * (0.4 + 0.6 * centre)) * full
    outer = inner.copy()
    height = -np.diff(y, axis=0)
    inwards = INWARDS + 0.7 * (1 - centre)  # and the front edges beside the cheek
    for row in range(1, ROWS):
        thick = THICK_M * edge * (1.0 - 0.55 * t[row] ** 3) * full[row]
        outer[row] = np.maximum(inner[row] + thick, outer[row - 1] - inwards * height[row - 1])
    wander = np.stack([np.broadcast_to(0.5 * s, y.shape), 0.25 * y, 0 * y], -1).reshape(-1, 3)
    clump = lumps(wander, 0.035, seed + 6).reshape(y.shape)
    ripple = np.sin(2 * np.pi * (y / 0.075) + 2.0 * lumps(wander, 0.12, seed + 7).reshape(y.shape))
    for _ in range(4):  # no kink where hair leaves the cap, nor over the ears
        inside = outer[1:-1]
        inside[:] = np.maximum(0.25 * outer[:-2] + 0.5 * inside + 0.25 * outer[2:], inner[1:-1])
    outer += style.wave / 1000 * (clump + 0.7 * ripple * t[:, None]) * full * edge
    outer = np.maximum(outer, inner + 0.002 * t[:, None])
    inner = np.maximum(inner, outer - 1.3 * THICK_M)
    inner[0] = outer[0] - 0.003
    middle = 0.5 * (inner[-1] + outer[-1])
    outer[-1], inner[-1] = middle + 0.0015, middle - 0.0015
    both = np.concatenate([outer, inner[:, ::-1]], 1)
    angles, heights = (np.concatenate([each, each[:, ::-1]], 1) for each in (angle, y))
    # The front edges lie a little towards the face, more where hair is long.
    return np.stack([both * np.sin(angles), heights, both * np.cos(angles) - 0.005], -1)


def _azimuth(s: Float64Array, y: Float64Array) -> Float64Array:
    """Where columns are at these heights, from the subject's left over the back, radians."""
    front = np.interp(y, *FRONT_DEG)
    return np.radians(180 - s * (180 - front))


def _reach(body: Float64Array, angle: Float64Array, y: Float64Array) -> Float64Array:
    """How far a body goes out from the head's axis, by direction and height. ``[C]``."""
    near = body[(body[:, 1] > y.min() - 0.012) & (body[:, 1] < y.max() + 0.012)]
    place = np.arctan2(near[:, 0], near[:, 2] + 0.005)
    far = np.hypot(near[:, 0], near[:, 2] + 0.005)
    off = np.abs((place - angle[:, None] + np.pi) % (2 * np.pi) - np.pi)
    here = (off < 0.12) & (np.abs(near[:, 1] - y[:, None]) < 0.011)
    return np.where(here, far, 0.0).max(1, initial=0.0)
