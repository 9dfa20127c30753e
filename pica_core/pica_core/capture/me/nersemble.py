"""A person of NeRSemble v2 as it was published: films and no mesh. The first pictures of all
cameras' films of one take are photos of one moment."""

from pathlib import Path

import av
import numpy as np

from pica_core.capture.dataset.dataset import NERSEMBLE
from pica_core.capture.dataset.multiface import read_json
from pica_core.capture.me.photos import (
    DIAGONAL_MM,
    Photo,
    Tell,
    photo_of,
    photo_paths,
    read_photos,
    upright,
)
from pica_core.errors import CaptureError
from pica_core.face_networks import FaceNetworks

SIZE = (2200, 3208)
"""Of the pictures that its calibration is for."""


def is_nersemble(folder: Path) -> bool:
    """Whether a folder is one person of that data set."""
    return (folder / NERSEMBLE).is_file()


def camera_films(folder: Path) -> list[Path]:
    """The films of the take that has most of them; of several the last, which begins calmly.

    Raises:
        CaptureError: There is none.
    """
    takes = [(len(list(take.glob("*.mp4"))), take) for take in folder.glob("sequences/*/images")]
    return photo_paths(max(takes, default=(0, folder))[1], (".mp4",))


def read_films(films: list[Path], networks: FaceNetworks, tell: Tell) -> list[Photo]:
    """The first pictures of films as photos; what is of no use is told and left out.

    Raises:
        CaptureError: None is of use, or the calibration says nothing.
    """
    calibration = films[0].parents[3] / NERSEMBLE
    told = read_json(calibration)
    try:
        focal_px, count = float(told["intrinsics"][0][0]), len(told["world_2_cam"])
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise CaptureError(
            f"{calibration}: intrinsics and world_2_cam are needed ({error!r})"
        ) from error
    film_mm = DIAGONAL_MM * focal_px / float(np.hypot(*SIZE))
    tell(f"{films[0].parent}: first pictures of {len(films)} films, of {count} cameras")

    def read(path: Path, networks: FaceNetworks) -> Photo:
        try:
            with av.open(str(path)) as film:
                picture = upright(next(film.decode(video=0)))
        except (OSError, ValueError, StopIteration, IndexError, av.FFmpegError) as error:
            raise CaptureError(f"{path}: not a film that can be read ({error})") from error
        return photo_of(path.name, picture, film_mm, "NeRSemble", networks, str(path))

    return read_photos(films, networks, tell, read)
