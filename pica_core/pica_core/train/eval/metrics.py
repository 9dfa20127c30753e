"""Figures of merit of pictures, as functions of arrays and nothing else.

All take values on 0-255, and judge the pixels that a mesh covers, as the paper's tables do ("Mean
Squared Error between rendered image and original image on rasterized pixels", section 6).
"""

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from pica_core.types import BoolArray, Float64Array

FloatArray = npt.NDArray[np.floating]
Image = FloatArray | npt.NDArray[np.uint8]

WHITE = 255.0
SSIM_SIGMA_PX = 1.5
SSIM_REACH_PX = 5
"""Gaussian window of 11 x 11 pixels (Wang et al., "Image Quality Assessment", 2004, section
III-B)."""
SSIM_CONSTANTS = ((0.01 * WHITE) ** 2, (0.03 * WHITE) ** 2)
RESAMPLES = 2000
"""Draws of the bootstrap: the ends of a 95 % interval are good to a few percent of its width."""
BEST_PSNR_DB = 100.0
"""What a picture without any error counts as."""


def mse(predicted: FloatArray, observed: FloatArray) -> float:
    """Mean squared difference over pixels and channels, ``[P, 3]`` both."""
    return float(np.square(predicted.astype(np.float64) - observed).mean())


def psnr_db(error: float) -> float:
    """Peak signal to noise ratio of a mean squared error on 0-255."""
    if error <= 0:
        return BEST_PSNR_DB
    return min(BEST_PSNR_DB, float(10 * np.log10(WHITE**2 / error)))


def ssim(predicted: Image, observed: Image, covered: BoolArray) -> float:
    """Mean structural similarity of the covered pixels, channel by channel.

    Args:
        predicted: ``[H, W, 3]``; outside the covered pixels it should hold what `observed` holds,
            so that windows across the rim compare like with like.
        observed: ``[H, W, 3]``.
        covered: Which pixels count, ``[H, W]``; 1 where none does.
    """
    if not covered.any():
        return 1.0
    rows, columns = (np.flatnonzero(covered.any(axis)) for axis in (1, 0))
    box = tuple(
        slice(max(0, index[0] - SSIM_REACH_PX), index[-1] + SSIM_REACH_PX + 1)
        for index in (rows, columns)
    )
    a = predicted[box].astype(np.float64)
    b = observed[box].astype(np.float64)
    c1, c2 = SSIM_CONSTANTS
    mean_a, mean_b = _blur(a), _blur(b)
    variance_a = _blur(a * a) - mean_a**2
    variance_b = _blur(b * b) - mean_b**2
    covariance = _blur(a * b) - mean_a * mean_b
    similar = (2 * mean_a * mean_b + c1) * (2 * covariance + c2)
    similar /= (mean_a**2 + mean_b**2 + c1) * (variance_a + variance_b + c2)
    return float(similar[covered[box]].mean())


def change_mse(
    predicted: tuple[FloatArray, FloatArray], observed: tuple[FloatArray, FloatArray]
) -> float:
    """Error of the change from one frame to the next: what flickers, or moves too late. Colours of
    the same pixels in two frames, ``[P, 3]`` each, as predicted and as seen."""
    before, after = (np.asarray(part, np.float64) for part in predicted)
    seen_before, seen_after = (np.asarray(part, np.float64) for part in observed)
    return float(np.square((after - before) - (seen_after - seen_before)).mean())


def bootstrap_interval(values: npt.ArrayLike) -> tuple[float, float]:
    """The 95 % percentile interval of the mean, over resamples of the values with repetition.

    Args:
        values: Of frames ``[T]``, or of several runs on the same frames ``[runs, T]``; then runs
            and frames are drawn independently of each other.

    Frames are taken as independent; those of one take are not quite, so for them it is a little
    narrow.
    """
    array = np.atleast_2d(np.asarray(values, np.float64))
    rng = np.random.default_rng(0)
    runs, frames = array.shape
    frame = rng.integers(frames, size=(RESAMPLES, frames))
    run = rng.integers(runs, size=(RESAMPLES, runs))
    means = array[run[:, :, None], frame[:, None]].mean((1, 2))
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def _blur(image: Float64Array) -> Float64Array:
    """Gaussian means; beyond the border the last pixel goes on."""
    means: Float64Array = gaussian_filter(
        image, SSIM_SIGMA_PX, mode="nearest", radius=SSIM_REACH_PX, axes=(0, 1)
    )
    return means
