"""A face that is followed from picture to picture, and the samples that come of it."""

from PIL import Image

from pica_client.sources.live.sample import TrackerSample
from pica_client.sources.webcam.head_pose import head_pose
from pica_client.sources.webcam.networks import FaceNetworks, Region, region_of
from pica_core.types import FloatArray

PRESENT = 0.5
"""Below this the landmarks' network does not believe that there is a face."""
MAX_SIDE = 4.0
"""A region larger than so many pictures is none."""


class FaceFinder:
    """Follows one face: the largest that it finds, until it is lost.

    Attributes:
        num_detections: How often it had to look for a face.
        landmarks: Of the last picture, pixels, float32 ``[478, 3]``; None if there is no face.
    """

    def __init__(self, networks: FaceNetworks) -> None:
        self.num_detections = 0
        self.landmarks: FloatArray | None = None
        self._networks = networks

    def find(self, picture: Image.Image, time_s: float | None) -> TrackerSample:
        """Take the next picture, RGB and not mirrored, and when it was taken by its camera."""
        # Where the face was a moment ago, or, if it is not there any more, anywhere.
        former = None if self.landmarks is None else region_of(self.landmarks)
        if former is None or not self._follow(picture, former):
            self.num_detections += 1
            if not any(self._follow(picture, each) for each in self._networks.detect(picture)):
                return TrackerSample(tracker_s=time_s, has_face=False)
        assert self.landmarks is not None
        rotation, place_m = head_pose(self.landmarks, *picture.size)
        return TrackerSample(
            tracker_s=time_s,
            arkit=self._networks.shapes(self.landmarks),
            rotation=rotation,
            place_m=place_m,
        )

    def _follow(self, picture: Image.Image, region: Region) -> bool:
        """Look for the landmarks in a region of the picture."""
        self.landmarks = None
        if not 1 < region.side < MAX_SIDE * max(picture.size):
            return False
        landmarks, presence = self._networks.landmarks(picture, region)
        if presence >= PRESENT:
            self.landmarks = landmarks
        return self.landmarks is not None
