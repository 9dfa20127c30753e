"""Where one shape ends because of another: lips that have met, lids that have met."""

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.capture.rig.features import LID_M, Features
from pica_core.capture.rig.mesh import RigMesh
from pica_core.errors import ShapeError
from pica_core.types import Float64Array, FloatArray


class Limits:
    """What keeps values of a rig's shapes from pushing skin through skin.

    Attributes:
        corrective_close: True when mouthClose takes back a part of jawOpen, as ARKit's does.
    """

    def __init__(self, mesh: RigMesh, features: Features) -> None:
        self.corrective_close = _is_corrective(mesh)
        self._lids = [
            (index, _closing(mesh, features, side, index))
            for side, name in ((1.0, "Left"), (-1.0, "Right"))
            for index in (ARKIT_INDEX[f"eyeBlink{name}"],)
        ]

    def apply(self, arkit: npt.ArrayLike) -> FloatArray:
        """Values as they are posed. float32 ``[52]``.

        Raises:
            ShapeError: `arkit` does not have 52 values.
        """
        values = np.array(arkit, np.float32)
        if values.shape != (NUM_ARKIT,):
            raise ShapeError(f"arkit is {values.shape}; [{NUM_ARKIT}] is needed")
        if self.corrective_close:
            # Alone it is nonsense: lips cannot close further than the jaw has opened them.
            close, opening = ARKIT_INDEX["mouthClose"], ARKIT_INDEX["jawOpen"]
            values[close] = min(values[close], max(float(values[opening]), 0.0))
        for blink, closing in self._lids:
            # A glance down or a squint has closed a part of the way already.
            beyond = float(closing @ np.clip(values, 0.0, None)) - 1.0
            values[blink] -= np.clip(beyond, 0.0, max(float(values[blink]), 0.0))
        return values


def _is_corrective(mesh: RigMesh) -> bool:
    opened = mesh.motion_m[ARKIT_INDEX["jawOpen"], :, 1]
    closed = mesh.motion_m[ARKIT_INDEX["mouthClose"], :, 1]
    if not closed.any() or not opened.any():
        return False
    at = np.abs(closed) > 0.3 * np.abs(closed).max()
    return bool(np.mean(closed[at] * opened[at] < 0) > 0.6)


def _closing(mesh: RigMesh, features: Features, side: float, blink: int) -> Float64Array:
    """How far each shape at 1 closes the lids of an eye, where its blink at 1 is 1. ``[52]``."""
    rest, edge = mesh.rest_m, features.regions["lids"] & (features.eye_gap_m < LID_M)
    eyes = [eye for eye in mesh.eyes if eye.side == side]
    closing = np.zeros(NUM_ARKIT)
    for eye in eyes:
        middle = edge & (np.abs(rest[:, 0] - eye.centre_m[0]) < 0.5 * eye.radius_m)
        upper, lower = middle & features.above_eye, middle & ~features.above_eye
        if upper.any() and lower.any():
            rise = [mesh.motion_m[:, lid, 1].mean(1, dtype=np.float64) for lid in (upper, lower)]
            closing = rise[1] - rise[0]
    return closing / closing[blink] if closing[blink] > 0.002 else np.zeros(NUM_ARKIT)
