"""Everything that is not skin: eyeballs, teeth, tongue, mouth cavity, ears and collar, at rest.

Each function fills one chart's grid with positions in the head frame, millimetres, ``[R, C, 3]``.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pica_core.capture.identity import FaceShape
from pica_core.capture.layout import Chart
from pica_core.capture.skin import bump, smoothstep
from pica_core.capture.surface import EYE_RADIUS, HeadField, cast

Float64Array = npt.NDArray[np.float64]


def _disc(chart: Chart) -> tuple[Float64Array, Float64Array]:
    """The chart's square mapped onto the unit disc: x to the right, y up."""
    rows, columns = chart.unit
    a, b = 0.96 * (2 * columns - 1), 0.96 * (1 - 2 * rows)  # full corners would fold flat
    return a * np.sqrt(1 - 0.5 * b * b), b * np.sqrt(1 - 0.5 * a * a)


def eyeball(chart: Chart, centre: tuple[float, ...], side: float) -> Float64Array:
    """An eyeball that looks along +z, iris in the middle of its chart.

    Args:
        chart: Its chart.
        centre: Centre of the subject's left eyeball, mm.
        side: +1 for the subject's left eye, -1 for the right one.
    """
    x, y = _disc(chart)
    reach = np.hypot(x, y)
    # Density: half of the grid on the visible front.
    angle = np.radians(108.0) * (0.72 * reach + 0.28 * reach**3)
    radius = EYE_RADIUS + 0.32 * np.exp(
        -((angle / 0.42) ** 4)
    )  # a hint of a cornea, kept below the lids
    turn = np.arctan2(y, x)
    points = np.stack(
        [np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], -1
    )
    points = points * radius[..., None]
    # Beyond what gaze can show, the ball flares into a skirt that fills the corners of the eye.
    flare = smoothstep(np.radians(62.0), np.radians(114.0), angle)[..., None]
    nasal = np.clip(-side * np.cos(turn), 0.0, 1.0)
    skirt = np.stack(
        [(16.2 + 0.8 * nasal) * np.cos(turn), 12.6 * np.sin(turn), 1.0 + 4.5 * nasal**2], -1
    )
    points = points + flare * (skirt - points)
    placed: Float64Array = points + np.array([side * centre[0], centre[1], centre[2]])
    return placed


def eye_fixed(chart: Chart) -> Float64Array:
    """How firmly eye vertices stay as the eye turns: 0 on the ball, 1 on its skirt. ``[R, C]``."""
    x, y = _disc(chart)
    reach = np.hypot(x, y)
    angle = np.radians(108.0) * (0.72 * reach + 0.28 * reach**3)
    return smoothstep(np.radians(60.0), np.radians(80.0), angle)


def teeth(chart: Chart, front_z: float, edge_y: float, *, upper: bool) -> Float64Array:
    """A dental arch with its gum; rows run from the gum over the edge to the back of the teeth.

    Args:
        chart: Its chart.
        front_z: Front of the central incisors, mm.
        edge_y: Height of the incisal edges, mm.
        upper: True for the upper arch.
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


def mouth_bag(chart: Chart, mouth_y: float, front_z: float) -> Float64Array:
    """The inside of the mouth: a bowl that opens towards the lips."""
    x, y = _disc(chart)
    reach = np.minimum(np.hypot(x, y), 1.0)
    turn = np.arctan2(y, x)
    ring = np.sin(0.5 * np.pi * np.clip(1.25 * reach, 0, 1))
    px = 36.0 * ring * np.cos(turn)
    py = mouth_y + 1.0 + np.where(y > 0, 22.0, 27.0) * ring * np.sin(turn)
    pz = front_z - 52.0 + 46.0 * reach**2.6 - 15.0 * (px / 36.0) ** 2
    return np.stack([px, py, pz], -1)


def ear(chart: Chart, field: HeadField, face: FaceShape, side: float) -> Float64Array:
    """An ear: rows run round the outline, columns from the concha over the helix to the back.

    Args:
        chart: Its chart.
        field: The head that it sits on.
        face: Proportions; `ear_length` scales the ear.
        side: +1 for the subject's left ear.
    """
    rows, columns = chart.unit
    size = face.ear_length / 62.0
    turn = 2 * np.pi * rows  # 0 is the front, a quarter turn is the top, half a turn the back
    forward, up = np.cos(turn), np.sin(turn)
    # Outline: broad above, narrow at the lobe; the front is the straight line where it is attached.
    height = np.where(up > 0, 30.0, 33.0)
    breadth = np.where(
        forward > 0, 10.0, 20.5 - 7.5 * smoothstep(0.1, -1.0, up) + 1.5 * bump(up, 0.55, 0.4)
    )
    free = smoothstep(0.55, -0.15, forward - 0.30 * np.clip(up, 0, 1))  # 0 where attached
    lobe = smoothstep(-0.62, -0.95, up)
    s = columns
    #            concha      wall       antihelix  scapha     helix      edge       behind     root
    stations = [0.0, 0.18, 0.34, 0.44, 0.54, 0.66, 0.76, 0.84, 0.92, 1.0]
    radius = np.interp(s, stations, [0.02, 0.30, 0.50, 0.62, 0.78, 0.90, 1.00, 0.98, 0.84, 0.55])
    free_height = np.interp(s, stations, [0.5, 1.0, 8.6, 10.2, 8.2, 11.6, 12.2, 9.4, 5.5, -6.0])
    flat_height = np.interp(s, stations, [0.5, 0.8, 2.6, 3.4, 2.6, 1.2, -0.6, -2.5, -4.5, -7.0])
    lobe_height = np.interp(s, stations, [0.5, 1.0, 6.5, 8.0, 8.4, 8.4, 7.6, 5.2, 2.0, -6.0])
    raised = free * ((1 - lobe) * free_height + lobe * lobe_height) + (1 - free) * flat_height
    tragus = 6.5 * np.exp(-(((up - 0.02) / 0.34) ** 2)) * (forward > 0) * bump(s, 0.42, 0.12)
    raised = raised + tragus * smoothstep(0.2, 0.9, forward)
    # The concha lies ahead of the middle and below it.
    local_back = -forward * breadth * radius * size
    local_up = (up * height * radius + 2.0 * (1 - radius)) * size
    tilt = np.radians(14.0)  # the ear's long axis leans back
    z = -9.0 + 3.0 - (local_back * np.cos(tilt) + local_up * np.sin(tilt))
    y = 1.0 + local_up * np.cos(tilt) - local_back * np.sin(tilt)
    flat = np.stack([np.full_like(z, 30.0), y, z], -1).reshape(-1, 3)
    out = np.broadcast_to([1.0, 0.0, 0.0], flat.shape)
    wall = cast(field, flat, out)[:, 0].reshape(z.shape)
    wall = 0.5 * wall + 0.5 * np.median(wall)
    flare = 0.36 * np.maximum(local_back, 0.0) * smoothstep(0.0, 0.5, 1.12 - s)
    x = wall - 2.0 + (raised + flare) * size
    return np.stack([side * x, y, z], -1)


def collar(chart: Chart, face: FaceShape) -> Float64Array:
    """A round neckline and the slope of the shoulders; hides where the neck ends."""
    rows, columns = chart.unit
    turn = 2 * np.pi * columns
    front, sideways = -np.cos(turn), -np.sin(turn)  # starts and ends at the back
    neck = 0.5 * face.neck_breadth
    s = rows
    slope = np.clip(s / 0.62, 0.0, 1.0)  # neckline to the point of the shoulder
    drop = np.clip((s - 0.62) / 0.38, 0.0, 1.0)  # then straight down, out of the picture
    rim_x, rim_z = neck + 0.5, 53.0
    reach = slope**0.9
    x = sideways * (rim_x + (168.0 - rim_x) * reach * (0.55 + 0.45 * np.abs(sideways)) + 6.0 * drop)
    z = -16.0 + front * (rim_z + 34.0 * reach + 8.0 * drop) - 8.0 * slope * np.abs(sideways)
    rim_y = -106.0 - 22.0 * np.clip(front, -0.25, 1.0) + 6.0 * np.abs(sideways)
    y = (
        rim_y
        - (20.0 + 26.0 * np.maximum(front, 0.0)) * slope**1.25
        - 26.0 * slope**3 * np.abs(sideways)
    )
    y = y - 95.0 * drop
    hem = bump(s, 0.14, 0.06)
    inside = np.clip(
        1 - s / 0.14, 0.0, 1.0
    )  # the first row lies within the neck: no gap behind the neckline
    x, z = x * (1 - 0.22 * inside), -16.0 + (z + 16.0) * (1 - 0.22 * inside)
    y = y - 5.0 * inside
    return np.stack([x * (1 + 0.03 * hem), y + 1.5 * hem, z + front * 1.5 * hem], -1)
