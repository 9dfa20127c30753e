"""Find a rig's units and axes from what its shapes move, and put it where all heads are.

Left shapes move the subject's left, eyes and brows lie above mouth and jaw, and the face is where
the motion is. Axes snap to the file's own axes: a rig that stands askew in its file is left askew.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pica_core.capture.rig.names import NameMap
from pica_core.errors import CaptureError
from pica_core.types import Float64Array, FloatArray

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
FACE_M = (0.036, 0.36)
"""From the middle of what eye shapes move to the middle of what mouth shapes move: 60 to 85 mm in
people. One decade around that, so that exactly one of the units fits."""
EYES_AT_M = (0.0, 0.022, 0.074)
"""Where the middle between the eyeballs goes."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RigFrame:
    """How the file's coordinates become ours: ``p = axes @ q * unit + offset``.

    Attributes:
        unit: ``m``, ``cm`` or ``mm``.
        axes: Rows are our x, y, z in the file's axes; -1 as determinant means a mirrored file.
            float64 ``[3, 3]``.
        guessed: What could not be found and was assumed, in words.
    """

    unit: str
    axes: Float64Array
    guessed: tuple[str, ...]

    def points(self, positions: npt.NDArray[np.floating]) -> Float64Array:
        """Positions or displacements in metres and our axes, without an offset. ``[..., 3]``."""
        return positions @ self.axes.T * UNITS[self.unit]

    def describe(self) -> str:
        """Axes in words, such as ``x y z`` or ``x z -y`` (our x, y, z in the file's axes)."""
        words = []
        for row in self.axes:
            at = int(np.argmax(np.abs(row)))
            words.append(("-" if row[at] < 0 else "") + "xyz"[at])
        return " ".join(words)


def _centre(
    positions: Float64Array, shapes: dict[str, FloatArray], names: list[str]
) -> Float64Array | None:
    """Mean position weighted by how far the shapes move each vertex; None without motion."""
    weight = np.zeros(len(positions))
    for name in names:
        length = np.linalg.norm(shapes[name], axis=1)
        if length.max() > 0:
            weight += (length / length.max()) ** 2
    if weight.sum() <= 0:
        return None
    return weight @ positions / weight.sum()


def find_frame(positions: Float64Array, shapes: dict[str, FloatArray], names: NameMap) -> RigFrame:
    """Units and axes of a rig, from its neutral vertices and its displacements by source name.

    Raises:
        CaptureError: No unit makes this a head.
    """

    def moved(*prefixes: str, side: str = "") -> Float64Array | None:
        sources = [
            driver.source
            for arkit, drivers in names.drivers.items()
            if arkit.startswith(prefixes) and arkit.endswith(side)
            for driver in drivers
            if not driver.half
        ]
        return _centre(positions, shapes, sources)

    guessed = []
    middle = 0.5 * (positions.min(0) + positions.max(0))
    sided = ("eye", "brow", "cheek", "nose", "mouthSmile", "mouthFrown", "mouthDimple")
    left, right = moved(*sided, side="Left"), moved(*sided, side="Right")
    lateral = np.ones(3)
    if left is None or right is None:
        # Shapes of one side: across the head is the axis about which the mesh is its own image.
        lateral = (np.arange(3) == np.argmin(_asymmetry(positions - middle))).astype(np.float64)
        left = 2 * middle - right if left is None and right is not None else left
        right = 2 * middle - left if right is None and left is not None else right
    upper, lower = moved("eye", "brow"), moved("jaw", "mouth")
    face = moved("eye", "brow", "jaw", "mouth", "cheek", "nose")
    axes = np.eye(3)
    if left is None or right is None or upper is None or lower is None or face is None:
        guessed.append("axes (+y up, +z out of the face): too few shapes to find them")
    else:
        x = _snap(left - right, lateral)
        y = _snap(upper - lower, 1 - np.abs(x))
        z = _snap(face - middle, 1 - np.abs(x) - np.abs(y))
        axes = np.stack([x, y, z])
    if upper is not None and lower is not None:
        length = float(np.abs(axes[1] @ (upper - lower)))
        what = "from eyes to mouth"
    else:
        length = float(np.ptp(positions @ axes[1])) / 4
        what = "a quarter of its height"
        guessed.append("unit: found from the height of the whole mesh")
    for unit, scale in UNITS.items():
        if FACE_M[0] <= length * scale < FACE_M[1]:
            return RigFrame(unit=unit, axes=axes, guessed=tuple(guessed))
    raise CaptureError(
        f"the rig measures {length:.4g} {what}; as m, cm or mm that is no head "
        f"({FACE_M[0]} to {FACE_M[1]} m is)"
    )


def _asymmetry(offsets: Float64Array) -> Float64Array:
    """How little the mesh looks the same from both ends of each axis, 0 for a mirror image."""
    order = np.sort(offsets, axis=0)
    return np.abs(order + order[::-1]).mean(0) / np.ptp(offsets, axis=0)


def _snap(direction: Float64Array, free: Float64Array) -> Float64Array:
    """The signed file axis nearest to a direction, among the free ones."""
    at = int(np.argmax(np.abs(direction) * free))
    axis = np.zeros(3)
    axis[at] = 1.0 if direction[at] >= 0 else -1.0
    return axis
