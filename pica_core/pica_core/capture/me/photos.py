"""Photos of a person as their files have them, the landmarks in each, and a fit of those."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pi_heif import register_heif_opener
from PIL import Image, ImageOps
from scipy.ndimage import gaussian_filter

from pica_core.camera import Camera, look_at
from pica_core.capture.me.face import (
    Similarity,
    align,
    landmark_places,
    landmark_table,
    landmark_values,
)
from pica_core.capture.me.solve import Sight, Solution, Spots, solve
from pica_core.capture.person.choices import NUM_MODES, FaceModel, read_model
from pica_core.capture.rig.mesh import fit_sphere
from pica_core.errors import CaptureError
from pica_core.face_networks import NUM_LANDMARKS, FaceNetworks, region_of
from pica_core.types import ByteArray, Float64Array, FloatArray

register_heif_opener()

PHONE_FOCAL_MM, DIAGONAL_MM = 27.0, 43.27
"""Usual focal length of phones, for a picture of 35 mm film, and the diagonal of that."""
KNOWN, UNKNOWN = 0.04, 0.15
"""How far a focal length may be off, relative: of a file, and of a phone that is not named."""
LEAST_M = 0.0004
"""No landmark is trusted more."""
IRISES = slice(468, 478)
PUPILS, CHEEKS, LEAST_BRIGHT = (468, 473), (50, 280), 0.45
"""Landmarks, and how bright eyes are beside cheeks at least (measured: drawn people's and a real
photo's from 0.9, under sunglasses to 0.13)."""
SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".heic", ".heif")
MODES = ("RGB", "RGBA", "L", "P")
BROKEN = (OSError, SyntaxError, ValueError, TypeError, EOFError, RuntimeError)
"""What readers of damaged files raise."""
MOST_PHOTOS, MOST_SIDE, SIDE = 60, 12_000, 1920
"""Photos, their longest side in pixels, and to what they are reduced."""
EXIF_IFD, FILM_FOCAL, MODEL = 0x8769, 0xA405, 0x0110
SURE, LEAST_FACE_PX, MOST_TURNED, LEAST_SHARP = 0.6, 80, 62.0, 0.22
"""What a photo needs: sureness of the networks, width of the face in pixels, degrees from the
front, and `sharpness` (measured on drawn people)."""
Tell = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Photo:
    """A photo with one face.

    Attributes:
        image: sRGB, upright. uint8 ``[H, W, 3]``.
        landmarks: Columns, rows and depths in pixels. ``[478, 3]``.
        focal_px: As its file says, 0 where it does not.
        pose: From an average face to the landmarks, about.
        lens: What photos of one lens share.
        sharp: See `sharpness`.
    """

    name: str
    image: ByteArray
    landmarks: FloatArray
    focal_px: float
    pose: Similarity
    lens: tuple[object, ...]
    sharp: float


Read = Callable[[Path, FaceNetworks], Photo]


def photo_paths(folder: Path, kinds: tuple[str, ...] = SUFFIXES) -> list[Path]:
    """The photos of a folder, by their suffixes.

    Raises:
        CaptureError: There is none, or too many.
    """
    try:
        paths = sorted(each for each in folder.iterdir() if each.suffix.lower() in kinds)
    except OSError as error:
        raise CaptureError(f"{folder}: {error.strerror}; name the folder of photos") from error
    if not 0 < len(paths) <= MOST_PHOTOS:
        told = f"1 to {MOST_PHOTOS} are taken, with names on {', '.join(kinds)}"
        raise CaptureError(f"{folder}: {len(paths)} photos; {told}")
    return paths


def read_photos(
    paths: list[Path], networks: FaceNetworks, tell: Tell, read: Read | None = None
) -> list[Photo]:
    """Read photos, as `read_photo` does or `read`; what is of no use is told and left out.

    Raises:
        CaptureError: None is of use.
    """
    photos: list[Photo] = []
    for path in paths:
        try:
            photos.append((read or read_photo)(path, networks))
        except CaptureError as error:
            tell(f"left out: {error}")
    if not photos:
        raise CaptureError(f"{paths[0].parent}: no photo is of use; each line above says why")
    return photos


def read_photo(path: Path, networks: FaceNetworks) -> Photo:
    """Read a photo, upright.

    Raises:
        CaptureError: It cannot be read, or does not show one face well; names file and remedy.
    """
    try:
        with Image.open(path) as opened:
            if max(opened.size) > MOST_SIDE:
                raise CaptureError(
                    f"{path}: {opened.width}x{opened.height}; sides up to "
                    f"{MOST_SIDE} are read: make it smaller"
                )
            if opened.mode not in MODES:
                raise CaptureError(f"{path}: pixels are {opened.mode}; save it with 8 bits as RGB")
            exif = opened.getexif()
            told = {**exif, **exif.get_ifd(EXIF_IFD)}
            picture = ImageOps.exif_transpose(opened).convert("RGB")
        film_mm = float(told.get(FILM_FOCAL) or 0)
    except (*BROKEN, Image.DecompressionBombError) as error:
        raise CaptureError(f"{path}: not a complete photo ({error}); save it again") from error
    picture.thumbnail((SIDE, SIDE), Image.Resampling.BOX, reducing_gap=None)
    return photo_of(path.name, picture, film_mm, told.get(MODEL), networks, str(path))


def upright(frame: Any) -> Image.Image:
    """A frame of a film as a photo."""
    picture: Image.Image = frame.to_image()
    picture.thumbnail((SIDE, SIDE), Image.Resampling.BOX, reducing_gap=None)
    return picture.rotate(int(getattr(frame, "rotation", 0) or 0), expand=True)


def photo_of(
    name: str, picture: Image.Image, film_mm: float, model: object, networks: FaceNetworks,
    where: str,
) -> Photo:  # fmt: skip
    """Find the one face of a picture.

    Raises:
        CaptureError: There is none, or not one that is seen well; begins with `where`.
    """
    regions = networks.detect(picture)
    if not regions:
        raise CaptureError(f"{where}: no face is found; show the whole face, in light")
    if len(regions) > 1 and regions[1].side > 0.5 * regions[0].side:
        raise CaptureError(f"{where}: two people; cut the picture to one")
    landmarks, sure = networks.landmarks(picture, regions[0])
    for _ in range(2):
        landmarks, sure = networks.landmarks(picture, region_of(landmarks))
    low, high = landmarks[:, :2].min(0), landmarks[:, :2].max(0)
    if sure < SURE:
        raise CaptureError(f"{where}: no face is sure; no sunglasses, no hand, not from behind")
    if min(high - low) < LEAST_FACE_PX:
        raise CaptureError(
            f"{where}: the face is {min(high - low):.0f} px wide; {LEAST_FACE_PX} are needed: "
            "come nearer"
        )
    if (low < 0).any() or (high > picture.size).any():
        raise CaptureError(f"{where}: the face is cut off; show all of it, with the forehead")
    places = landmark_places()
    pose = align(places.mean_m, landmarks.astype(np.float64), places.noise_m**-2)
    if -pose.rotation[2, 2] < np.cos(np.radians(MOST_TURNED)):
        raise CaptureError(f"{where}: a profile; turn to the camera, up to 45 degrees off")
    image = np.asarray(picture)
    sharp = sharpness(image, low, high)
    if sharp < LEAST_SHARP:
        raise CaptureError(f"{where}: blurred; hold the camera still, in more light")
    if brightness_of_eyes(image, landmarks) < LEAST_BRIGHT:
        raise CaptureError(f"{where}: the eyes are dark; take sunglasses off, into more light")
    return Photo(
        name=name, image=image, landmarks=landmarks,
        focal_px=film_mm / DIAGONAL_MM * float(np.hypot(*picture.size)),
        pose=pose, lens=(model, film_mm, tuple(sorted(picture.size))), sharp=sharp,
    )  # fmt: skip


def sharpness(image: ByteArray, low: FloatArray, high: FloatArray) -> float:
    """How strong details of a part of an image are beside its coarser ones: a face of 100 samples
    a side, so that it does not hang on its size."""
    (left, top), (right, bottom) = np.maximum(low, 0).astype(int), high.astype(int)
    grey = image[top:bottom, left:right].mean(2)
    pixel = max(min(grey.shape) / 200, 1.0)
    one, two, four, eight = (gaussian_filter(grey, pixel * sigma) for sigma in (1, 2, 4, 8))
    return float(np.std(one - two) / max(float(np.std(four - eight)), 1e-3))


def brightness_of_eyes(image: ByteArray, landmarks: FloatArray) -> float:
    """How bright the brighter parts around the pupils are beside the cheeks."""
    reach = int(0.07 * np.ptp(landmarks[:, 0])) + 1

    def around(landmark: int, percent: float) -> float:
        column, row = landmarks[landmark, :2].astype(int)
        rows, columns = (slice(max(at - reach, 0), at + reach) for at in (row, column))
        return float(np.percentile(image[rows, columns].mean(2), percent))

    eyes, cheeks = max(around(k, 90) for k in PUPILS), max(around(k, 50) for k in CHEEKS)
    return eyes / max(cheeks, 1.0)


def landmark_spots(model: FaceModel) -> Spots:
    """The 478 landmarks of the face networks; their offsets are those that a person's landmarks
    have from all sides."""
    table, places = landmark_table(), landmark_places()
    precision = np.maximum(table["noise_mm"][:, 0] / 1000, LEAST_M)[:, None, None] ** -2 * np.eye(3)
    return Spots(
        mean_m=places.mean_m,
        identity_m=places.identity_m.transpose(1, 2, 0),
        motion_m=landmark_values(model.mean.motion_m).transpose(1, 2, 0),
        offset_precision=precision,
    )


def size_of(pupils_m: float) -> tuple[Float64Array, float]:
    """The size of a head whose pupils are so far apart when it looks far, as `solve` has it."""
    model = read_model()

    def apart(rest: Float64Array) -> float:
        left, right = (fit_sphere(rest[eye.vertices])[0] for eye in model.mean.eyes)
        return float(np.linalg.norm(left - right))

    usual = apart(model.mean.rest_m)
    grows = np.array([apart(model.mean.rest_m + mode) - usual for mode in model.modes_m])
    length = float(np.linalg.norm(grows))
    return grows / length, (pupils_m - usual) / length


def first_guess(photos: list[Photo]) -> tuple[Solution, list[tuple[float, float]]]:
    """A face of average shape in each photo, and what is known of the lenses."""
    lenses = list(dict.fromkeys(photo.lens for photo in photos))
    cameras, priors = [], [(0.0, 0.0)] * len(lenses)
    for photo in photos:
        height, width = photo.image.shape[:2]
        usual = PHONE_FOCAL_MM / DIAGONAL_MM * float(np.hypot(height, width))
        focal = photo.focal_px or usual
        priors[lenses.index(photo.lens)] = (focal, KNOWN if photo.focal_px else UNKNOWN)
        pose = photo.pose
        middle = np.array([width / 2, height / 2, 0.0])
        cameras.append(
            Camera(
                name=photo.name,
                intrinsics=np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]),
                rotation=pose.rotation,
                translation_m=(pose.translation - middle) * [1, 1, 0] / pose.scale
                + [0, 0, focal / pose.scale],
                width=width,
                height=height,
            )
        )
    return Solution(
        coefficients=np.zeros(NUM_MODES),
        expressions=np.zeros((len(photos), 52)),
        cameras=tuple(cameras),
        offset_m=np.zeros((NUM_LANDMARKS, 3)),
        lens=np.array([lenses.index(photo.lens) for photo in photos]),
    ), priors


def landmark_sight(photo: Photo, camera: Camera) -> Sight:
    """What landmarks say, without what the networks put off in such a view."""
    table = landmark_table()
    bias_m = table["view_bias_mm"] / 1000
    near_m, far_m = table["noise_mm"][:, 1:].T / 1000
    away = camera.centre_m / np.linalg.norm(camera.centre_m)
    azimuth, elevation = np.clip([np.arctan2(away[0], away[2]), np.arcsin(away[1])], -0.9, 0.9)
    level = look_at(centre_m=away, target_m=np.zeros(3), vertical_fov=1.0, width=2, height=2)
    roll = (camera.rotation @ level.rotation.T)[:2, :2]
    off_m = bias_m @ view_terms(azimuth, elevation) @ roll.T
    per_metre = camera.intrinsics[0, 0] / camera.translation_m[2]
    share = np.clip((abs(azimuth) - 0.3) / 0.4, 0, 1)
    noise = per_metre * np.maximum(near_m + (far_m - near_m) * share, LEAST_M)
    precision = np.eye(2) / noise[:, None, None] ** 2
    precision[IRISES] = 0
    return Sight(pixels=photo.landmarks[:, :2] - per_metre * off_m, precision=precision)


def view_terms(azimuth: float, elevation: float) -> Float64Array:
    """What the networks' errors are linear in, for a view from there, radians. ``[6]``."""
    a, e = azimuth, elevation
    return np.array([1.0, a, a * a, e, a**3, a * e])


def fit_landmarks(photos: list[Photo], pupils_m: float | None) -> tuple[Solution, Spots]:
    """Fit cameras, identity and expressions to landmarks, twice, since what is known of landmarks
    depends on the view."""
    size = None if pupils_m is None else size_of(pupils_m)
    found, priors = first_guess(photos)
    spots = landmark_spots(read_model())
    for rounds, is_rough in ((9, True), (8, False)):
        sights = [landmark_sight(*pair) for pair in zip(photos, found.cameras, strict=True)]
        found = solve(spots, sights, found, priors, size=size, rounds=rounds, is_rough=is_rough)
    return found, spots
