"""The frames of a film that are worth being photos: sharp, and from sides that differ."""

from pathlib import Path

import numpy as np
from PIL import Image

from pica_core.capture.me.photos import Photo, Tell, photo_of, upright
from pica_core.errors import CaptureError
from pica_core.face_networks import FaceNetworks
from pica_core.types import Float64Array

LEAST_S, DENSE_S = 2.0, 120.0
"""Shortest film, and how much of a longer one is looked at whole; of the rest only key frames."""
LOOKED_AT, FRAMES = 60, 12
"""Frames that are looked at, and that are taken."""
NEAR = 0.12
"""Frames whose views differ less, radians, are one."""


def choose_frames(path: Path, networks: FaceNetworks, tell: Tell) -> list[Photo]:
    """Choose frames of a film.

    Raises:
        CaptureError: It cannot be read, is too short or too long, or shows no face.
    """
    frames = _frames(path)
    photos, why = [], ""
    for second, picture in frames:
        name = f"{path.name} at {second:.1f} s"
        try:
            photos.append(photo_of(name, picture, 0.0, "film", networks, name))
        except CaptureError as error:
            why = str(error)
    if not photos:
        raise CaptureError(f"{path}: none of {len(frames)} frames is of use; the last: {why}")
    chosen = spread_out(
        np.array([_view(photo) for photo in photos]), np.array([photo.sharp for photo in photos])
    )
    tell(f"{len(frames)} frames looked at, {len(photos)} show one face well, {len(chosen)} taken")
    return [photos[k] for k in sorted(chosen)]


def spread_out(views: Float64Array, sharp: Float64Array) -> list[int]:
    """Choose frames by their views ``[N, 2]``, radians, and sharpness ``[N]``: of those that are
    alike the sharpest, of these the ones farthest from each other; the most frontal first."""
    taken: list[int] = []
    for number in np.argsort(-sharp):
        if all(np.linalg.norm(views[number] - views[k]) > NEAR for k in taken):
            taken.append(int(number))
    apart = np.linalg.norm(views[taken][:, None] - views[taken], axis=2)
    order = [int(np.linalg.norm(views[taken], axis=1).argmin())]
    while len(order) < min(FRAMES, len(taken)):
        order.append(int(apart[:, order].min(1).argmax()))
    return [taken[k] for k in order]


def _view(photo: Photo) -> Float64Array:
    """Azimuth and elevation from which a photo was taken, about, radians."""
    away = -photo.pose.rotation[2]
    return np.array([np.arctan2(away[0], away[2]), np.arcsin(np.clip(away[1], -1, 1))])


def _frames(path: Path) -> list[tuple[float, Image.Image]]:
    """Frames at even times, upright, with their seconds since the first."""
    import av

    try:
        with av.open(str(path)) as film:
            if not film.streams.video:
                raise CaptureError(f"{path}: no pictures, sound alone; name a film")
            stream = film.streams.video[0]
            stream.thread_type = "AUTO"
            found: list[tuple[float, Image.Image]] = []
            first, step, last = 0.0, 0.0, 0.0
            for number, frame in enumerate(film.decode(stream)):
                now = frame.time if frame.time is not None else number / 30
                first = now if number == 0 else first
                last = now - first
                if last > DENSE_S:  # whole minutes cost minutes
                    stream.codec_context.skip_frame = "NONKEY"
                if not found or last - found[-1][0] > 0.99 * step:
                    found.append((last, upright(frame)))
                if len(found) > 2 * LOOKED_AT:  # an unknown length: take every second one
                    found = found[::2]
                    step = found[1][0] - found[0][0]
    except (OSError, ValueError, IndexError, av.FFmpegError) as error:
        raise CaptureError(f"{path}: not a film that can be read ({error})") from error
    if last < LEAST_S:
        raise CaptureError(f"{path}: {last:.1f} s; at least {LEAST_S:.0f} s are needed, better 15")
    return found
