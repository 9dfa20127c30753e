"""Find a face in a picture, as a webcam does it thirty times a second.

You learn what lies between a camera and the 52 shapes: a detector that runs only while no face is
followed, 478 landmarks in a crop that follows the face, and a network that names the shapes; the
head's turn comes from the landmarks. Nothing of the picture goes any further. Without the networks
(`pica webcam setup`) or a picture the example shows the geometry alone, on a head of its own.

    python examples/21_a_webcam.py [OUT] [PICTURE.jpg]
"""

import math
import sys

import numpy as np
from PIL import Image

from pica_client.sources.live_face import rotation_vector_from_yaw_pitch_roll
from pica_client.sources.webcam import FaceFinder
from pica_core.avatar.arkit import ARKIT_NAMES
from pica_core.errors import FaceNetworksError
from pica_core.face_networks import Region, load_networks


def find(path: str) -> None:
    """Say what the networks see in a picture."""
    try:
        networks = load_networks()
    except FaceNetworksError as error:
        print(error)
        return
    finder = FaceFinder(networks)
    sample = finder.find(Image.open(path).convert("RGB"), None)
    if not sample.has_face:
        print("no face")
        return
    for index in np.argsort(-sample.arkit)[:8]:
        print(f"{ARKIT_NAMES[index]:>20} {sample.arkit[index]:.2f}")
    print("turn in degrees:", np.degrees(sample.rotation).round(1))


if len(sys.argv) > 2:
    find(sys.argv[2])
else:
    print("a picture to look at: python examples/21_a_webcam.py OUT PICTURE.jpg")

# Where a face was a moment ago, there it is looked for: a square that turns with the eyes.
region = Region(x=320.0, y=240.0, side=200.0, angle=math.radians(20))
nose = region.to_picture(np.array([[0.5, 0.6, 0.0]], np.float32))[0]
print("the middle of the crop, and a bit below, in the picture:", nose[:2].round(1))
turn = rotation_vector_from_yaw_pitch_roll(np.radians([[30.0, 0.0, 0.0]]))[0]
print("a head that looks to its left by 30 degrees:", turn.round(2))
