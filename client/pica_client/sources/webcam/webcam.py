"""A webcam as a tracker. Its pictures stay in this process: what leaves it is the latent."""

import time
from contextlib import suppress

import numpy as np
from PIL import Image, ImageDraw

from pica_client.errors import SourceError
from pica_client.sources.live.calibration import Calibration
from pica_client.sources.live.tracker import SampleTap, Tracker
from pica_client.sources.webcam.camera import device_of, open_camera, pictures
from pica_client.sources.webcam.face_finder import FaceFinder
from pica_client.sources.webcam.networks import FaceNetworks
from pica_core.types import Image as Picture

REOPEN_S = 2.0
"""How often a camera that was pulled is looked for."""
PREVIEW_WIDTH = 320


class Webcam(Tracker):
    """A camera that is read from its making to `close`."""

    def __init__(
        self,
        device: str,
        networks: FaceNetworks,
        calibration: Calibration | None = None,
        tap: SampleTap | None = None,
    ) -> None:
        """Open a camera by its number or name, empty for the first, or a video instead of one.

        Raises:
            SourceError: It cannot be opened.
        """
        super().__init__(calibration, tap)
        self.finder = FaceFinder(networks)
        self._device = device
        self._is_video = device_of(device)[1] is None
        self._trouble = "webcam: no picture yet"
        self._picture: Image.Image | None = None
        self._container = open_camera(device)
        self._thread.start()

    @property
    def trouble(self) -> str:
        """Say what is wrong, see `Tracker.trouble`."""
        return self._trouble

    def preview(self) -> Picture | None:
        """What the camera sees, as in a mirror, with the landmarks in it; never sent. uint8
        ``[H, W, 3]``, 320 columns; None before the first picture."""
        picture, landmarks = self._picture, self.finder.landmarks
        if picture is None:
            return None
        scale = PREVIEW_WIDTH / picture.width
        small = picture.resize((PREVIEW_WIDTH, max(round(picture.height * scale), 1)))
        if landmarks is not None:
            draw = ImageDraw.Draw(small)
            draw.point([(x * scale, y * scale) for x, y, _ in landmarks.tolist()], (90, 255, 160))
        return np.asarray(small)[:, ::-1].copy()

    def _read(self) -> None:
        while not self._closing.is_set():
            reason = "gives no more pictures"
            try:
                self._show()
            except Exception as error:  # whatever a camera or a network throws, the call goes on
                reason = f"cannot be read: {error}"
            self._container.close()
            if self._closing.is_set():
                return
            self._trouble = f"webcam: {device_of(self._device)[0]} {reason}"
            self._reopen()

    def _show(self) -> None:
        """Take pictures until there are no more."""
        for picture, time_s in pictures(self._container, self._is_video, self._closing.wait):
            began_s = time.monotonic()
            sample = self.finder.find(picture, time_s)
            self._picture = picture
            self.subjects[""] += 1
            self._trouble = "" if sample.has_face else "webcam: no face in the picture"
            self._push(sample, began_s, began_s)

    def _reopen(self) -> None:
        """Wait until the camera is there again."""
        while not self._closing.wait(REOPEN_S):
            with suppress(SourceError):
                self._container = open_camera(self._device)
                return
