"""Controls of the own face while it is sent: choose another source, calibrate the tracker, see what
it sees.

    controls = FaceControls(publisher, person="Ada", source="livelink")
    controls.choose("vmc")
    controls.calibrate(now)
    controls.take_notices(now)              # what became of it, for people
"""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Final

from pica_client.errors import SourceError
from pica_client.publish.publisher import Publisher
from pica_client.sources import Tracker, open_source
from pica_client.sources.calibration import Calibration, CalibrationStore, calibrate
from pica_client.sources.registry import calibrations, split_source
from pica_client.sources.source import Unseen
from pica_core.types import Image

REST_S: Final = 1.5
"""How long a face at rest is looked at."""


@dataclass(frozen=True, slots=True)
class TrackerPreview:
    """What the tracker sees, for its owner alone.

    Attributes:
        has_face: Whether it sees a face.
        picture: A camera's, uint8 ``[H, W, 3]``; None of other trackers.
    """

    has_face: bool
    picture: Image | None


class FaceControls:
    """Steers one publisher. All methods are for one thread, which need not be the publisher's.

    Args:
        person: Whose calibrations are meant.
        source: What plays the face, as `sources.open_source` took it.
        store: Where calibrations are kept; by default this user's place for them.
    """

    def __init__(
        self,
        publisher: Publisher,
        person: str,
        source: str,
        store: CalibrationStore | None = None,
    ) -> None:
        self.publisher = publisher
        self.source = source
        self._person = person
        self._store = store or calibrations()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="own-face")
        self._opening: tuple[str, Future[None]] | None = None
        self._rested_s: float | None = None
        self._notices: list[str] = []

    def close(self) -> None:
        """Wait for a source that is being opened."""
        self._pool.shutdown()

    def choose(self, source: str) -> None:
        """Take another source once it is open; the one before stays where that fails."""
        if self._opening is None and source != self.source:
            self._rested_s = None
            self._opening = source, self._pool.submit(self._open, source)

    def calibrate(self, now: float) -> None:
        """Look at the face at rest from now on, and make a calibration of that."""
        source = self.publisher.source
        if not isinstance(source, Tracker):
            self._notices.append("Only a tracker is calibrated: choose one in the settings")
            return
        source.face.recent.clear()
        self._rested_s = now + REST_S
        self._notices.append("Look ahead, relaxed, with open eyes …")

    def take_notices(self, now: float) -> list[str]:
        """What became of what was asked for, since the last call; called in every frame."""
        if self._opening is not None and self._opening[1].done():
            (source, opening), self._opening = self._opening, None
            try:
                opening.result()
                self.source = source
                self._notices.append(f"Your face comes from {source}")
            except (SourceError, ModuleNotFoundError) as error:
                self._notices.append(str(error))
        if self._rested_s is not None and now >= self._rested_s:
            self._rested_s = None
            self._notices.append(self._learn())
        notices, self._notices = self._notices, []
        return notices

    def preview(self) -> TrackerPreview | None:
        """What the tracker sees; None where no tracker plays the face."""
        source, frame = self.publisher.source, self.publisher.seen
        if not isinstance(source, Tracker) or frame is None:
            return None
        return TrackerPreview(frame.has_face, source.preview())

    def _learn(self) -> str:
        source = self.publisher.source
        if not isinstance(source, Tracker):
            return ""
        kind, _ = split_source(self.source)
        before = self._store.load(self._person, kind) or Calibration()
        try:
            found = calibrate(list(source.face.recent), ())
            found = replace(before, neutral=found.neutral, lid_open=found.lid_open)
            self._store.save(self._person, kind, found)
        except SourceError as error:
            return f"Not calibrated: {error}"
        source.face.calibration = found
        return f"Calibrated for {self._person} and {kind}"

    def _open(self, source: str) -> None:
        self.publisher.replace_source(Unseen())  # both may want the same port or camera
        try:
            opened = open_source(source, person=self._person)
        except (SourceError, ModuleNotFoundError):
            self.publisher.replace_source(open_source(self.source, person=self._person))
            raise
        self.publisher.replace_source(opened)
