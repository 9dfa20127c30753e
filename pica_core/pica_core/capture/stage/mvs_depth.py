"""Exact depth made into what a multi-view stereo method would find.

- Holes: along silhouettes and depth steps, where a window sees two surfaces; where the surface is
  grazed; in blotches on what stereo cannot match (hair, wet eyes, the inside of the mouth), and few
  elsewhere.
- Noise that grows as the surface turns away and is smooth over a matching window.
- Outliers: blotches that landed on a wrong match, millimetres to centimetres off.

Amounts are chosen; `docs/capture.md` shows what comes of them.
"""

import numpy as np
from scipy.ndimage import maximum_filter, uniform_filter
from scipy.special import ndtri

from pica_core.camera import Camera
from pica_core.types import BoolArray, ByteArray, FloatArray, Int64Array

NOISE_M = 0.00015
"""Standard deviation along the ray on a surface that faces the camera."""
WINDOW = 0.008
"""Half the matching window, as a share of the image's shorter side; at least 1 pixel."""
STEP_M = 0.006
"""Neighbouring depths that differ by more are a step."""
LEAST_COSINE = 0.22
"""Surfaces that turn away further are not found."""
OUTLIER_RATIO = 0.01
"""Share of the found pixels that are wrong matches."""
OUTLIER_M = (0.004, 0.04)
"""How far off those are, either way."""
BLOTCH = 0.02
"""Size of blotches, as a share of the image's shorter side."""
HOLE_RATIO: dict[str, float] = {
    "hair": 0.65,
    "eye": 0.5,
    "teeth": 0.85,
    "tongue": 0.85,
    "mouth_bag": 1.0,
}
"""Share of a material that is not found, by its name in the mask."""
ELSEWHERE_RATIO = 0.02


def find_depth(
    depth_m: FloatArray,
    mask: ByteArray,
    camera: Camera,
    materials: dict[int, str],
    random: np.random.Generator,
    outlier_ratio: float = OUTLIER_RATIO,
) -> FloatArray:
    """Depth as a method would find it, 0 where nothing was found. float32 ``[H, W]``.

    Args:
        depth_m: Exact depth along the camera axis, 0 where empty. ``[H, W]``.
        mask: What is seen; `materials` names its values. ``[H, W]``.
    """
    side = min(depth_m.shape)
    window = max(1, round(WINDOW * side))
    cosine = _facing(depth_m, camera)
    seen = (depth_m > 0) & ~_near_step(depth_m, STEP_M, window) & (cosine > LEAST_COSINE)
    blotches = _blotches(random, depth_m.shape, max(2.0, BLOTCH * side))
    ratio = np.full(256, ELSEWHERE_RATIO, np.float32)
    for value, name in materials.items():
        ratio[value] = HOLE_RATIO.get(name, ELSEWHERE_RATIO)
    found = seen & (blotches >= ndtri(ratio)[mask])
    noise = _smooth_noise(random, depth_m.shape, window) * NOISE_M / np.maximum(cosine, 0.1)
    result = depth_m + noise
    size = max(2.0, 0.5 * BLOTCH * side)
    cells = _cell_index(depth_m.shape, size)
    count = int(cells[-1, -1]) + 1
    offset = random.uniform(*OUTLIER_M, count) * random.choice((-1.0, 1.0), count)
    wrong = _blotches(random, depth_m.shape, size) < ndtri(outlier_ratio)
    result[wrong] += offset.astype(np.float32)[cells[wrong]]
    return np.where(found, result, 0.0).astype(np.float32)


def _facing(depth_m: FloatArray, camera: Camera) -> FloatArray:
    """Cosine between the surface and the ray, from depth alone; 0 where empty. ``[H, W]``."""
    h, w = depth_m.shape
    k = camera.intrinsics
    x = ((np.arange(w) + 0.5 - k[0, 2]) / k[0, 0]).astype(np.float32)
    y = ((np.arange(h) + 0.5 - k[1, 2]) / k[1, 1]).astype(np.float32)
    x, y, inner = x[None], y[:, None], (slice(1, -1), slice(1, -1))
    point = x * depth_m, y * depth_m, depth_m
    ax, ay, az = (p[1:-1, 2:] - p[1:-1, :-2] for p in point)  # across
    dx, dy, dz = (p[2:, 1:-1] - p[:-2, 1:-1] for p in point)  # down
    nx, ny, nz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    x, y = x[:, 1:-1], y[1:-1]
    size = np.sqrt(nx * nx + ny * ny + nz * nz) * np.sqrt(x * x + y * y + np.float32(1.0))
    cosine: FloatArray = np.zeros_like(depth_m)
    cosine[inner] = np.abs(nx * x + ny * y + nz) / np.maximum(size, 1e-20)
    cosine[depth_m <= 0] = 0.0
    return cosine


def _near_step(depth_m: FloatArray, step_m: float, reach: int) -> BoolArray:
    """Pixels within `reach` of background or of a step in depth, along rows or columns."""
    step = np.zeros(depth_m.shape, np.bool_)
    down = np.abs(np.diff(depth_m, axis=0)) > step_m
    across = np.abs(np.diff(depth_m, axis=1)) > step_m
    step[1:] |= down
    step[:-1] |= down
    step[:, 1:] |= across
    step[:, :-1] |= across
    return maximum_filter(step, 2 * reach + 1)


def _smooth_noise(random: np.random.Generator, shape: tuple[int, int], reach: int) -> FloatArray:
    """Noise of unit variance: half of its variance per pixel, half shared within a window."""
    fine = random.standard_normal(shape, np.float32)
    size = 2 * reach + 1
    shared = size * uniform_filter(random.standard_normal(shape, np.float32), size, mode="nearest")
    return np.sqrt(np.float32(0.5)) * (fine + shared)


def _cell_index(shape: tuple[int, int], size: float) -> Int64Array:
    """A cell's number for each pixel, cells of about `size` pixels."""
    rows = (np.arange(shape[0]) / size).astype(np.int64)
    columns = (np.arange(shape[1]) / size).astype(np.int64)
    return rows[:, None] * (columns[-1] + 1) + columns[None]


def _blotches(random: np.random.Generator, shape: tuple[int, int], size: float) -> FloatArray:
    """Smooth blotches, normally distributed. ``[H, W]``."""
    rows, columns = (int(n / size) + 3 for n in shape)
    grid = random.standard_normal((rows, columns), np.float32)
    shift = random.random(2)
    r, c = (np.arange(n) / size + s for n, s in zip(shape, shift, strict=True))
    r0, c0 = r.astype(np.int64), c.astype(np.int64)
    fr, fc = (r - r0).astype(np.float32)[:, None], (c - c0).astype(np.float32)[None]
    # Along rows first, while there are few of them.
    along = grid[:, c0] * (1 - fc) + grid[:, c0 + 1] * fc
    value: FloatArray = along[r0] * (1 - fr) + along[r0 + 1] * fr
    value /= np.sqrt(((1 - fr) ** 2 + fr**2) * ((1 - fc) ** 2 + fc**2))
    return value
