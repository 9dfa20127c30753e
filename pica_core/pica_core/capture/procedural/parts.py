"""Everything that is not skin: eyeballs, teeth, tongue, mouth cavity, ears and collar, at rest.

Each function fills one chart's grid with positions in the head frame, millimetres, ``[R, C, 3]``.
"""

import numpy as np

from pica_core.capture.procedural.layout import Chart
from pica_core.capture.procedural.skin import EyeSurface, bump, smoothstep
from pica_core.capture.procedural.surface import EYE_RADIUS, HeadField, cast
from pica_core.types import Float64Array


def _disc(chart: Chart) -> tuple[Float64Array, Float64Array]:
    """The chart's square mapped onto the unit disc: x to the right, y up."""
    rows, columns = chart.unit
    a, b = 0.96 * (2 * columns - 1), 0.96 * (1 - 2 * rows)  # full corners would fold flat
    return a * np.sqrt(1 - 0.5 * b * b), b * np.sqrt(1 - 0.5 * a * a)


def _polar(chart: Chart) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Angle from the line of sight and direction around it (to the right, up) of eye vertices.

    Half of the grid lies on the visible front.
    """
    x, y = _disc(chart)
    reach = np.hypot(x, y)
    angle = np.radians(108.0) * (0.72 * reach + 0.28 * reach**3)
    turn = np.arctan2(y, x)
    return angle, np.cos(turn), np.sin(turn)


def eyeball(chart: Chart, surface: EyeSurface, side: float) -> Float64Array:
    """An eyeball that looks along +z, iris in the middle of its chart; `side` is +1 on the left."""
    angle, right, up = _polar(chart)
    # A hint of a cornea, kept below the lids.
    radius = EYE_RADIUS + 0.32 * np.exp(-((angle / 0.42) ** 4))
    x, y = radius * np.sin(angle) * right, radius * np.sin(angle) * up
    z = radius * np.cos(angle)
    # Beyond what gaze can show, the ball flares into a skirt just under the lids, which fills the
    # corners of the eye from every side.
    flare = smoothstep(np.radians(62.0), np.radians(112.0), angle)
    nasal = np.clip(-side * right, 0.0, 1.0)
    x = x + flare * ((18.0 + 1.5 * nasal) * right - x)
    y = y + flare * (13.5 * up - y)
    under = surface.depth(side * x, surface.centre[1] + y, 0.0) - surface.centre[2] - 0.9
    z = z + smoothstep(np.radians(62.0), np.radians(76.0), angle) * (under - z)
    centre = surface.centre
    return np.stack([x + side * centre[0], y + centre[1], z + centre[2]], -1)


def eye_fixed(chart: Chart) -> Float64Array:
    """How firmly eye vertices stay as the eye turns: 0 in front, 1 on the skirt. ``[R, C]``.

    The ball twists between: it stays a sphere.
    """
    return smoothstep(np.radians(48.0), np.radians(63.0), _polar(chart)[0])


def teeth(chart: Chart, front_z: float, edge_y: float, *, upper: bool) -> Float64Array:
    """A dental arch with its gum; rows run from the gum over the edge to the back of the teeth.

    `front_z` is the front of the central incisors, `edge_y` the height of their edges.
    """
    rows, columns = chart.unit
    t = 2 * columns - 1
    phi = 1.32 * t
    along = np.abs(t)
    width = 27.0 if upper else 22.5
    # Rows: gum root, gum line at 0.3, edge at 0.68, back of the teeth.
    sign = 1.0 if upper else -1.0
    crown = np.interp(along, [0, 0.16, 0.28, 0.42, 1], [9.6, 8.6, 9.4, 7.6, 6.4])
    height = np.interp(rows, [0, 0.3, 0.68, 0.74, 1.0], [1.9, 1.0, 0.0, 0.0, 1.2]) * crown
    depth = np.interp(
        rows, [0, 0.3, 0.4, 0.6, 0.68, 0.76, 1.0], [-1.6, 0.2, 1.0, 0.6, -0.2, -2.4, -7.0]
    )
    # Widths of the teeth along the arch: central, lateral, canine, premolars, molars.
    edges = np.array([0, 0.125, 0.225, 0.335, 0.445, 0.555, 0.74, 0.92, 1.05])
    tooth = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, len(edges) - 2)
    inside = (along - edges[tooth]) / (edges[tooth + 1] - edges[tooth])
    belly = np.sqrt(np.clip(1 - (2 * inside - 1) ** 2, 0, 1))
    on_crown = smoothstep(0.26, 0.36, rows) * smoothstep(0.8, 0.7, rows)
    depth = depth + on_crown * (0.9 * belly - 0.6)
    # Gum line scallops up between the teeth; edges are rounded at their corners.
    height = height + np.where(rows < 0.5, -0.9 * (1 - belly) * bump(rows, 0.3, 0.08), 0.0)
    height = height + 0.5 * (1 - belly) * bump(rows, 0.7, 0.05)
    lift = 0.8 * along**2 * (1.0 if upper else 0.6)  # curve of Spee
    x = (width + depth) * np.sin(phi) / np.sin(1.32)
    z = front_z - 34.0 * (1 - np.cos(phi)) / (1 - np.cos(1.32)) + depth * np.cos(phi)
    y = edge_y + sign * height + lift
    return np.stack([x, y, z], -1)


def tongue(chart: Chart, mouth_y: float, front_z: float) -> Float64Array:
    """The tongue's upper side, lying behind the lower teeth."""
    x, y = _disc(chart)
    reach = np.minimum(np.hypot(x, y), 1.0)
    turn = np.arctan2(y, x)
    angle = 1.85 * reach
    side, forward = np.sin(angle) * np.cos(turn), -np.sin(angle) * np.sin(turn)
    up = np.cos(angle)
    groove = 1.6 * np.exp(-((side / 0.16) ** 2)) * np.clip(up, 0, 1)
    px = 18.5 * side * (1 - 0.28 * np.clip(forward, 0, 1) ** 2)
    py = mouth_y - 15.0 + 8.0 * up - groove - 2.5 * forward
    pz = front_z - 33.0 + 24.0 * forward
    return np.stack([px, py, pz], -1)


def mouth_bag(chart: Chart, mouth_y: float, front_z: float, field: HeadField) -> Float64Array:
    """The inside of the mouth: a bowl that opens towards the lips, just inside the cheeks."""
    x, y = _disc(chart)
    reach = np.minimum(np.hypot(x, y), 1.0)
    turn = np.arctan2(y, x)
    ring = np.sin(0.5 * np.pi * np.clip(1.25 * reach, 0, 1))
    px = 43.0 * ring * np.cos(turn)
    py = mouth_y + 1.0 + np.where(y > 0, 22.0, 27.0) * ring * np.sin(turn)
    pz = front_z - 52.0 + 46.0 * reach**2.6 - 8.0 * (px / 43.0) ** 2
    behind = np.stack([px, py, 0 * pz], -1).reshape(-1, 3)
    skin = cast(field, behind, np.broadcast_to([0.0, 0.0, 1.0], behind.shape))[:, 2]
    return np.stack([px, py, np.minimum(pz, skin.reshape(pz.shape) - 4.0)], -1)


def ear(chart: Chart, field: HeadField, side: float) -> Float64Array:
    """An ear: rows run round the outline, columns from the concha over the helix to the back."""
    rows, columns = chart.unit
    size = field.face.ear_length / 62.0
    turn = 2 * np.pi * rows  # 0 is the front, a quarter turn is the top, half a turn the back
    forward, up = np.cos(turn), np.sin(turn)
    # Outline around the concha: broad above and behind, a rounded lobe below.
    degrees = [0, 25, 50, 75, 95, 120, 150, 180, 210, 235, 255, 272, 288, 305, 330, 360]
    outline = [10, 13, 22, 29.5, 31, 30.5, 26.5, 22.5, 20, 22, 27, 30.5, 29.5, 23, 13, 10]
    reach = np.interp(np.degrees(turn), degrees, outline)
    free = smoothstep(0.62, -0.05, forward - 0.42 * np.clip(up, 0, 1))  # 0 where attached
    lobe = smoothstep(-0.70, -0.97, up) * smoothstep(0.9, 0.2, np.abs(forward))
    s = columns
    #            concha      wall       antihelix  scapha     helix      edge       behind     root
    stations = [0.0, 0.18, 0.34, 0.44, 0.54, 0.66, 0.76, 0.84, 0.92, 1.0]
    radius = np.interp(s, stations, [0.02, 0.34, 0.52, 0.62, 0.78, 0.91, 1.00, 0.98, 0.86, 0.55])
    free_height = np.interp(s, stations, [1.0, 1.4, 8.4, 10.4, 7.4, 11.6, 11.4, 8.6, 5.0, -6.0])
    flat_height = np.interp(s, stations, [1.0, 1.3, 3.2, 4.0, 3.0, 1.0, -1.2, -3.0, -4.5, -7.0])
    lobe_height = np.interp(s, stations, [1.0, 1.4, 7.0, 8.0, 8.6, 8.6, 6.8, 4.4, 1.4, -6.0])
    raised = free * ((1 - lobe) * free_height + lobe * lobe_height) + (1 - free) * flat_height
    # Tragus over the ear canal, antitragus opposite, the helix running into the concha.
    tragus = 7.5 * np.exp(-(((up - 0.02) / 0.36) ** 2)) * (forward > 0) * bump(s, 0.40, 0.12)
    raised = raised + tragus * smoothstep(0.2, 0.9, forward)
    crus = np.exp(-(((np.degrees(turn) - 38.0) / 13.0) ** 2)) * bump(s, 0.42, 0.2)
    raised = raised + 4.0 * crus
    # The concha lies ahead of the middle and below it.
    local_back = -forward * reach * radius * size
    local_up = (up * reach * radius + 2.0 * (1 - radius)) * size
    tilt = np.radians(14.0)  # the ear's long axis leans back
    z = -9.0 + 3.0 - (local_back * np.cos(tilt) + local_up * np.sin(tilt))
    y = 1.0 + local_up * np.cos(tilt) - local_back * np.sin(tilt)
    flat = np.stack([np.full_like(z, 30.0), y, z], -1).reshape(-1, 3)
    out = np.broadcast_to([1.0, 0.0, 0.0], flat.shape)
    wall = cast(field, flat, out)[:, 0].reshape(z.shape)
    wall = 0.5 * wall + 0.5 * np.median(wall)
    flare = 0.24 * np.maximum(local_back, 0.0) * smoothstep(0.0, 0.5, 1.12 - s)
    x = wall + 0.4 + (0.9 * raised + flare) * size
    return np.stack([side * x, y, z], -1)


def collar(chart: Chart, field: HeadField) -> Float64Array:
    """A round neckline that lies on the neck, and the slope of the shoulders below it."""
    rows, columns = chart.unit
    turn = 2 * np.pi * columns
    front, sideways = -np.cos(turn), -np.sin(turn)  # starts and ends at the back
    axis_z = -30.0
    rim_y = -104.0 - 22.0 * smoothstep(-0.5, 1.0, front) + 5.0 * np.abs(sideways)
    origin = np.stack([0 * turn, rim_y, np.full_like(turn, axis_z)], -1).reshape(-1, 3)
    out = np.stack([sideways, 0 * turn, front], -1).reshape(-1, 3)
    on_neck = cast(field, origin, out)
    rim = np.hypot(on_neck[:, 0], on_neck[:, 2] - axis_z).reshape(turn.shape) + 2.2
    s = np.clip((rows - 0.16) / 0.84, 0.0, 1.0)
    slope = np.clip(s / 0.66, 0.0, 1.0)  # neckline to the point of the shoulder
    drop = np.clip((s - 0.66) / 0.34, 0.0, 1.0)  # then straight down, out of the picture
    edge = 1.0 / ((np.abs(sideways) / 172.0) ** 2.6 + (np.abs(front) / 96.0) ** 2.6) ** (1 / 2.6)
    reach = rim + (edge - rim) * slope + 7.0 * np.sin(0.5 * np.pi * drop)
    chest = np.maximum(front, 0.0) ** 1.5
    fall = (16.0 + 22.0 * chest) * slope + (20.0 - 8.0 * chest) * slope**3
    y = rim_y - fall - 96.0 * drop**1.4
    # The knitted rib stands up a little; the first rows tuck into the neck.
    rib = bump(rows, 0.17, 0.06)
    inside = np.clip(1 - rows / 0.14, 0.0, 1.0)
    reach = reach + 1.6 * rib - 9.0 * inside
    y = y + 2.0 * rib - 5.0 * inside
    return np.stack([sideways * reach, y, axis_z + front * reach], -1)
