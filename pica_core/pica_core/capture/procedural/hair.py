"""The hair shell: an opaque surface a little above the scalp, with clumps in its silhouette.

Rows run from the crown along the strands to the hair's edge, columns round the head starting and
ending at the back. Strands themselves are appearance (shaders), not geometry. Millimetres, head
frame.
"""

import numpy as np

from pica_core.capture.procedural.identity import Identity
from pica_core.capture.procedural.layout import Chart
from pica_core.capture.procedural.skin import smoothstep
from pica_core.capture.procedural.surface import HeadField, cast
from pica_core.types import Float64Array


def _periodic_noise(angle: Float64Array, seed: int, low: int, high: int) -> Float64Array:
    """Smooth noise over the circle with integer frequencies `low` to `high`, about unit size."""
    random = np.random.default_rng(seed)
    total = np.zeros_like(angle)
    for frequency in range(low, high + 1):
        phase, gain = random.uniform(0, 2 * np.pi), random.normal()
        total += gain * np.cos(frequency * angle + phase)
    return total / np.sqrt(0.5 * (high - low + 1))


COILED = 0.8
"""Hair with more curl than this is coils without strands: lumps instead of clumps."""


def _lumps(points: Float64Array, seed: int) -> Float64Array:
    """Smooth bumps in space a few millimetres to centimetres wide, about unit size. ``[...]``."""
    random = np.random.default_rng(seed + 3)
    total = np.zeros(points.shape[:-1])
    for _ in range(28):
        wave = random.normal(0.0, 0.16, 3)
        total += np.cos(points @ wave + random.uniform(0, 2 * np.pi))
    return total / np.sqrt(14.0)


def hairline(identity: Identity, azimuth: Float64Array) -> Float64Array:
    """Height of the hair's lower edge, mm, by azimuth, radians (0 front, pi back, sign ignored)."""
    hair, front, back = identity.hair, identity.hair.front, identity.hair.recession
    degrees = np.degrees(np.abs(azimuth))
    if hair.covers_ears:
        line = [(0, front), (20, front - 1), (38, front - 10), (52, 44.0), (62, hair.side)]
        line += [(75, hair.side - 8), (100, hair.side - 14), (140, hair.nape), (180, hair.nape)]
    else:
        line = [(0, front), (14, front + 1 + 0.3 * back), (30, front + 6 + back)]
        line += [(42, front - 2 + back), (50, front - 14 + 0.6 * back)]
        line += [(58, front - 28 + 0.2 * back), (68, hair.side + 10), (76, hair.side - 10)]
        line += [(84, hair.side - 22), (92, hair.side + 8), (106, hair.side + 14)]
        line += [(118, hair.side - 8), (135, hair.nape + 14), (155, hair.nape)]
        line += [(180, hair.nape + 2)]
    at, heights = np.array(line, np.float64).T
    if not hair.covers_ears:
        # No hairline is drawn with a ruler: a slight peak in the middle, and waves of its own.
        waves = _periodic_noise(np.radians(at * 2.0), identity.seed + 9, 2, 7)
        peak = -2.5 * np.exp(-((at / 7.0) ** 2))
        heights = heights + smoothstep(62.0, 48.0, at) * (1.2 * waves + peak)
    dense = np.arange(-30.0, 211.0)
    folded = np.interp(np.abs(np.where(dense > 180, 360 - dense, dense)), at, heights)
    kernel = np.exp(-0.5 * (np.arange(-9, 10) / 3.0) ** 2)
    smooth = np.convolve(np.pad(folded, 9, mode="edge"), kernel / kernel.sum(), "valid")
    return np.interp(degrees, dense, smooth)


def build_hair(identity: Identity, field: HeadField, chart: Chart) -> Float64Array:
    """Positions of the hair chart's vertices. ``[R, C, 3]``."""
    hair = identity.hair
    rows, columns = chart.unit
    # Columns crowd a little towards the face, where the edge is seen.
    c = 2 * columns - 1
    azimuth = np.pi * np.sign(c) * (0.82 * np.abs(c) + 0.18 * np.abs(c) ** 3)
    edge = hairline(identity, azimuth)
    edge = edge + 1.6 * _periodic_noise(azimuth, identity.seed, 17, 29) * smoothstep(
        0.2, 0.6, np.abs(azimuth)
    )
    # Along a strand: first over the cranium by latitude, then (long hair) straight down.
    t = np.clip(rows / 0.93, 0.0, 1.0)  # the last rows tuck the edge in
    tuck = np.clip((rows - 0.93) / 0.07, 0.0, 1.0)
    hang_from = np.minimum(np.maximum(edge, -20.0), 140)
    centre_y = 46.0
    reach_z = np.where(np.abs(azimuth) < np.pi / 2, 92.0, 88.0)
    reach = np.hypot(70.0 * np.sin(azimuth), reach_z * np.cos(azimuth))
    end_latitude = np.arctan2(
        hang_from - centre_y,
        np.sqrt(np.maximum(1 - ((hang_from - centre_y) / 92.0) ** 2, 0.1)) * reach,
    )
    hang = np.maximum(hang_from - edge, 0.0)
    share = hang / (hang + 90.0 * (0.5 * np.pi - end_latitude))
    on_head = np.clip(t / np.maximum(1 - share, 1e-6), 0, 1)
    drop = (
        np.where(share > 1e-3, np.clip((t - (1 - share)) / np.maximum(share, 1e-6), 0, 1), 0.0)
        * hang
    )
    latitude = 0.5 * np.pi - 0.02 - on_head * (0.5 * np.pi - 0.02 - end_latitude)
    direction = np.stack(
        [np.cos(latitude) * np.sin(azimuth), np.sin(latitude), np.cos(latitude) * np.cos(azimuth)],
        -1,
    )
    origin = np.broadcast_to([0.0, centre_y, 0.0], direction.shape)
    scalp = cast(field, origin.reshape(-1, 3), direction.reshape(-1, 3)).reshape(direction.shape)
    # Below the skull hair lies on cheek and neck: short hair all round, long hair at its front
    # edge only, so that no camera looks in behind it; farther back it hangs.
    level = np.where(drop > 0, scalp[..., 1] - drop, 0.0)
    flat = np.stack([np.sin(azimuth), 0 * azimuth, np.cos(azimuth)], -1)
    start = np.stack([0 * level, level, 0 * level], -1)
    lying_at = cast(field, start.reshape(-1, 3), flat.reshape(-1, 3)).reshape(flat.shape)
    if hair.covers_ears:
        hug = smoothstep(1.95, 1.25, np.abs(azimuth))[..., None] * (drop > 0)[..., None]
        hanging = scalp - drop[..., None] * [0.0, 1.0, 0.0]
        inwards = (hanging - lying_at) * [1.0, 0.0, 1.0]
        scalp = scalp - hug * inwards * smoothstep(0.0, 26.0, drop)[..., None]
        # Where the neck is wider than the hang of the hair, hair lies on it.
        reach = np.hypot(hanging[..., 0], hanging[..., 2])
        neck_reach = np.hypot(lying_at[..., 0], lying_at[..., 2])
        lift = np.maximum(neck_reach - reach, 0.0) * (drop > 0) * (1.0 - hug[..., 0])
        scalp = scalp + lift[..., None] * flat
    else:
        scalp = np.where((drop > 0)[..., None], lying_at, scalp)
        drop, hang = np.zeros_like(drop), np.zeros_like(hang)
    away = direction.copy()
    away[..., 1] *= 0.6
    front = smoothstep(1.15, 0.35, np.abs(azimuth))
    top = np.clip(np.sin(latitude), 0, 1)
    thickness = hair.side_thickness + (hair.top_thickness - hair.side_thickness) * top**0.8
    thickness = thickness + front * hair.fringe * smoothstep(0.45, 0.95, on_head)
    if hair.parting:
        part = np.radians(hair.parting)
        valley = np.exp(-((((azimuth - part) * np.cos(latitude)) / 0.05) ** 2))
        thickness = thickness * (
            1 - 0.55 * valley * (np.abs(azimuth) < 1.2) * smoothstep(0.1, 0.3, t)
        )
    if hair.covers_ears:
        over_ear = np.exp(-(((np.abs(azimuth) - 1.75) / 0.42) ** 2))
        beside_ear = smoothstep(0.75, 0.1, latitude) * smoothstep(50.0, 24.0, drop)
        thickness = thickness + 13.0 * over_ear * beside_ear
    clump = _periodic_noise(
        azimuth - hair.sweep * t + 0.35 * hair.curl * np.sin(6 * t + 2 * azimuth),
        identity.seed + 1,
        9,
        26,
    )
    wave = np.sin(16.0 * t + 3.0 * _periodic_noise(azimuth, identity.seed + 2, 3, 9))
    ragged = smoothstep(0.05, 0.5, t)
    if hair.curl > COILED:
        clump = 2.4 * _lumps(scalp, identity.seed)
        wave = np.zeros_like(wave)
    thickness = thickness + ragged * (
        0.9 * clump + 2.2 * hair.curl * wave * smoothstep(0.3, 0.8, t)
    )
    behind = smoothstep(1.6, 2.3, np.abs(azimuth))
    thickness = np.maximum(thickness + 3.0 * behind, 1.5)
    # Hair that does not hang grows out of the skin: its shell rises from below the hairline, where
    # the scalp is painted with roots, so no rim shows.
    to_edge = (1.0 - t) * (0.5 * np.pi - end_latitude) * 95.0
    rise = hair.rise * (1.0 + 0.5 * behind)
    lying = (hang < 1) * (1 - 0.9 * front * min(hair.fringe / 6.0, 1.0))
    grown = thickness * (1.0 - np.exp(-to_edge / rise)) - 2.0 * np.exp(-to_edge / 2.5)
    thickness = thickness + lying * (grown - thickness)
    points: Float64Array = scalp + away * thickness[..., None]
    points[..., 1] -= drop
    # Tuck the edge back under, so that the shell shows a rim and no gap; below hanging hair the
    # shell closes against the neck.
    short = away * (np.maximum(thickness, 0) + 2.5)[..., None]
    closing = (points - lying_at) * [0.95, 0.0, 0.95]
    points -= tuck[..., None] * np.where((hang > 1)[..., None], closing, short)
    points[..., 1] += tuck * 1.5
    return points
