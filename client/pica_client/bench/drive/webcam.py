"""A webcam simulation: a head drawn as a webcam would see it, and what the networks make of it.

The person sits before the camera in even light, calibrated by a picture at rest and one with closed
eyes; the camera has no noise and no blur. Heads are drawn, and the networks have learned people.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from PIL import Image

from pica_client.sources import Source
from pica_client.sources.live.calibration import Calibration, calibrate
from pica_client.sources.live.sample import TrackerSample
from pica_client.sources.live.smoothing import BLINKS
from pica_client.sources.webcam.face_finder import FaceFinder
from pica_client.sources.webcam.model import load_networks
from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.camera import look_at
from pica_core.capture.stage.subject import Subject
from pica_core.types import FloatArray

SIZE_PX: Final = (640, 480)
DISTANCE_M: Final = 0.6
VERTICAL_FOV: Final = 0.8
"""Opening of the camera from top to bottom, radians: a laptop's."""
WEBCAM_FPS: Final = 30


class SeenByWebcam:
    """A head before a webcam.

    Attributes:
        calibration: What `pica calibrate` learns of it.

    Raises:
        SourceError: The networks are not there; says how to fetch them.
    """

    def __init__(self, subject: Subject) -> None:
        self._subject = subject
        self._finder = FaceFinder(load_networks())
        self._camera = look_at(
            name="webcam",
            centre_m=(0.0, 0.02, DISTANCE_M),
            target_m=(0.0, 0.0, 0.0),
            vertical_fov=VERTICAL_FOV,
            width=SIZE_PX[0],
            height=SIZE_PX[1],
        )
        rest, closed = np.zeros((2, NUM_ARKIT), np.float32)
        closed[list(BLINKS)] = 1.0
        seen = [self._see(arkit, None).arkit for arkit in (rest, closed)]
        self.calibration: Calibration = calibrate(seen[:1], seen[1:])

    def tracker(self, source: Source) -> Callable[[float], TrackerSample]:
        """What the networks say of what a source does, for `steps.live_values`."""
        return lambda seen_s: self._see(source.frame_at(seen_s).arkit, seen_s)

    def _see(self, arkit: FloatArray, seen_s: float | None) -> TrackerSample:
        self._subject.pose(arkit)
        picture = self._subject.draw(self._camera).image
        return self._finder.find(Image.fromarray(picture), seen_s)
