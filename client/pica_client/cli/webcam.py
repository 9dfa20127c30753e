"""`pica webcam setup`: fetches the networks that a webcam needs, on request."""

from dataclasses import dataclass
from typing import Annotated, Any

from cyclopts import Parameter

from pica_client.output import say
from pica_client.sources.webcam.networks import SHA256, URL, install


@dataclass(frozen=True, kw_only=True, slots=True)
class WebcamOptions:
    """Options of `pica webcam setup`."""

    source: Annotated[str, Parameter(name="from")] = URL
    """Where the face landmarker lies: an address, or a face_landmarker.task."""


def webcam_setup(options: WebcamOptions) -> dict[str, Any]:
    """Fetch the networks that find a face in a webcam's pictures, 3.8 MB, and check them.

    It is MediaPipe's face landmarker (Apache 2.0). Nothing else is ever fetched for a webcam, and
    its pictures leave this program for nowhere.
    """
    say(f"from {options.source}")
    path = install(options.source)
    say(f"stored in {path}; now: pica track webcam")
    return {"path": str(path), "sha256": SHA256}
