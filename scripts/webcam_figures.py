"""How well a webcam's networks follow heads that are drawn, whose faces and poses are known.

    python scripts/webcam_figures.py [--json]      (after pica webcam setup)

The avatars that ship, drawn as a webcam sees them at 640 x 480: one shape at a time from 0 to 1 in
eleven steps, and 24 poses within 29 degrees of yaw and 17 of pitch and roll, each with its
expression at rest. What the networks say of a shape is correlated with what was drawn; the pose is
compared as it is, and after what is said of the head at rest is taken away, as a calibration does.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from PIL import Image

from pica_client.decode.decoder import OnnxDecoder
from pica_client.playout.rotation import rotation_vector_from_yaw_pitch_roll, turn_between
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, head_matrix, view_direction
from pica_client.render.seats import plan_seats
from pica_client.render.views import ViewState, plan_camera
from pica_client.sources.webcam.face_finder import FaceFinder
from pica_client.sources.webcam.model import load_networks
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar, load_avatar
from pica_core.avatar.shipped import shipped_avatar_files
from pica_core.gl import create_context

SIZE = (640, 480)
SHAPES = {
    "jaw": ("jawOpen",),
    "smile": ("mouthSmileLeft", "mouthSmileRight"),
    "blink": ("eyeBlinkLeft", "eyeBlinkRight"),
    "brows up": ("browInnerUp", "browOuterUpLeft", "browOuterUpRight"),
    "brows down": ("browDownLeft", "browDownRight"),
    "gaze left": ("eyeLookOutLeft", "eyeLookInRight"),
    "gaze right": ("eyeLookInLeft", "eyeLookOutRight"),
    "gaze up": ("eyeLookUpLeft", "eyeLookUpRight"),
    "gaze down": ("eyeLookDownLeft", "eyeLookDownRight"),
    "pucker": ("mouthPucker",),
    "funnel": ("mouthFunnel",),
}


class Studio:
    """One avatar before a webcam."""

    def __init__(self, avatar: Avatar, context: Any) -> None:
        self._encoder, self._decoder = ExpressionEncoder(avatar), OnnxDecoder(avatar)
        plan = plan_seats("grid", 1, SIZE[0] / SIZE[1])
        self._seat, self._camera = plan.seats[0], plan_camera(plan, ViewState(), *SIZE)
        self._renderer = Renderer(context, SIZE, RenderOptions(fade_busts=True))
        self._renderer.add_avatar("avatar", avatar)

    def picture(self, arkit: Any, rotation: Any) -> Image.Image:
        """What the webcam sees."""
        matrix = head_matrix(self._seat, np.asarray(rotation, np.float64), np.zeros(3))
        direction = view_direction(matrix, self._camera.centre_m)
        maps = self._decoder.decode(self._encoder.encode(arkit), direction)
        self._renderer.update_maps("avatar", maps.position_map, maps.expression_map)
        self._renderer.draw([Placement(slot="avatar", world_from_head=matrix)], self._camera)
        return Image.fromarray(self._renderer.read_image())


@contextmanager
def studio(avatar: Avatar) -> Iterator[Studio]:
    """Set one up, and take it down."""
    context = create_context()
    try:
        yield Studio(avatar, context)
    finally:
        context.release()


def degrees_between(one: Any, other: Any) -> float:
    """The angle of the turn from one rotation vector to another."""
    return float(np.degrees(np.linalg.norm(turn_between(one, other))))


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    networks = load_networks()
    rng = np.random.default_rng(7)
    rows, still = [], np.zeros(3, np.float32)
    spent_s, pictures, detections = 0.0, 0, 0
    for path in shipped_avatar_files():
        finder = FaceFinder(networks)
        row: dict[str, Any] = {"avatar": path.stem}
        with studio(load_avatar(path)) as stage:
            rest = np.zeros(NUM_ARKIT, np.float32)
            for name, shapes in SHAPES.items():
                places = [ARKIT_INDEX[shape] for shape in shapes]
                said = []
                for value in np.linspace(0, 1, 11):
                    arkit = rest.copy()
                    arkit[places] = value
                    # Twice: a camera shows a face more than once, and the region follows it.
                    sample = finder.find(stage.picture(arkit, still), None)
                    sample = finder.find(stage.picture(arkit, still), None)
                    said.append(float(np.mean(sample.arkit[places])))
                row[name] = round(float(np.corrcoef(said, np.linspace(0, 1, 11))[0, 1]), 3)
                row[f"{name} range"] = [round(said[0], 2), round(said[-1], 2)]
            plain, calibrated = [], []
            at_rest = finder.find(stage.picture(rest, still), None).rotation
            for angles in rng.uniform([-0.5, -0.3, -0.3], [0.5, 0.3, 0.3], (24, 3)):
                true = rotation_vector_from_yaw_pitch_roll(angles[None])[0]
                picture = stage.picture(rest, true)
                finder.landmarks = None
                finder.find(picture, None)
                began_s = time.process_time()
                sample = finder.find(picture, None)
                spent_s += time.process_time() - began_s
                plain.append(degrees_between(sample.rotation, true))
                calibrated.append(degrees_between(turn_between(at_rest, sample.rotation), true))
            row["pose_deg"] = [round(float(np.median(plain)), 1), round(max(plain), 1)]
            row["pose_calibrated_deg"] = [
                *(round(float(np.median(calibrated)), 1), round(max(calibrated), 1))
            ]
        pictures += 24
        detections += finder.num_detections
        rows.append(row)
        if not options.json:
            print(row)
    result = {"rows": rows, "ms_a_picture": round(1000 * spent_s / pictures, 2)}
    print(json.dumps(result) if options.json else result["ms_a_picture"])


if __name__ == "__main__":
    main()
