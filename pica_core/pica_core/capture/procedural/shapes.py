"""The 52 ARKit shapes as motion of the skin: displacement fields, and the weight with which skin
follows the jaw.

A shape is a few soft strokes ("move what lies around here by this much"). Strokes are written for
the subject's left (+x) and mirrored for the right. Rotations (jaw, eyes) and lids are not fields:
see `heads` and `lids`. Distances in millimetres at a shape value of 1.

What each shape should do follows Apple's published `ARFaceAnchor.BlendShapeLocation` descriptions;
`mouthClose` is a corrective that brings the lips together while the jaw stays open, so it is part
of the jaw (`heads`) and no field.
"""

from dataclasses import dataclass

import numpy as np

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.capture.procedural.layout import MOUTH_ROW, Chart
from pica_core.capture.procedural.skin import Skin, bump, mouth_lines, smoothstep
from pica_core.capture.procedural.surface import HeadField
from pica_core.types import Float64Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SkinMotion:
    """How the skin follows the shapes.

    Attributes:
        fields: Displacement at value 1 of each shape, mm. ``[52, R * C, 3]``.
        jaw: Share of the jaw's rotation and translation that each vertex takes. ``[R * C]``.
        jaw_closed: The same with the lips held together (`mouthClose`). ``[R * C]``.
    """

    fields: Float64Array
    jaw: Float64Array
    jaw_closed: Float64Array


class _Strokes:
    """Coordinates of the skin at rest and soft masks in them."""

    def __init__(self, field: HeadField, skin: Skin, chart: Chart) -> None:
        p = skin.points
        self.x, self.y, self.z = p[..., 0], p[..., 1], p[..., 2]
        self.half = skin.mouth_half
        self.rows = np.broadcast_to(chart.rows[:, None].astype(np.float64), self.x.shape)
        self.contact = mouth_lines(field, self.half, self.x)["contact"]
        self.t = np.abs(self.x) / self.half
        self.is_upper = self.rows <= MOUTH_ROW
        # Only the face moves: nothing behind the ears, nothing under the collar.
        self.front = smoothstep(-5.0, 40.0, self.z) * smoothstep(162.0, 152.0, self.rows)
        above = self.y - self.contact
        inner = np.maximum(1 - self.t**2, 0.0)
        reach_u, reach_l = smoothstep(17.0, 1.0, above), smoothstep(21.0, 3.0, -above)
        on_front = self.z > 60
        self.upper = np.where(self.is_upper & on_front, reach_u * inner, 0.0)
        self.lower = np.where(~self.is_upper & on_front, reach_l * inner, 0.0)
        around = np.where(above > 0, reach_u, reach_l) * smoothstep(
            self.half + 16, self.half - 4, np.abs(self.x)
        )
        self.mouth = around * on_front
        self.corner = bump(np.abs(self.x), self.half + 1, 9.0) * bump(above, 0.0, 10.0) * on_front
        # 0 on the contact line, 1 from the vermilion border outwards: for motions that thin a lip.
        self.off_contact = np.clip(np.abs(above) / 7.0, 0.0, 1.0) * np.sign(above)

    def left(self, soft: float = 7.0) -> Float64Array:
        """1 on the subject's left, 0 on the right, a soft step between."""
        return smoothstep(-soft, soft, self.x)

    def spot(self, x: float, y: float, sx: float, sy: float) -> Float64Array:
        """A soft spot at (x, y) on the front of the face."""
        return bump(self.x, x, sx) * bump(self.y, y, sy) * self.front


def _vector(weight: Float64Array, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Float64Array:
    return weight[..., None] * np.array([x, y, z])


def _sided(s: _Strokes, field: HeadField) -> dict[str, Float64Array]:
    """Shapes that exist once per side, for the subject's left."""
    face, left = field.face, s.left()
    corner = s.corner * left
    eye_x = 0.5 * face.eye_distance
    brow_y = 22.0 + face.brow_height
    cheek = s.spot(eye_x + 10, -8.0, 15.0, 13.0)
    below_eye = s.spot(eye_x + 3, 5.0, 15.0, 7.0)
    brow = s.spot(eye_x - 4, brow_y, 17.0, 9.0)
    inner_brow = s.spot(eye_x - 20, brow_y, 9.0, 9.0)
    outer_brow = s.spot(eye_x + 14, brow_y + 1, 13.0, 9.0)
    wing = s.spot(0.5 * face.nose_breadth - 3, field.subnasale_y + 7, 7.0, 8.0)
    fold = s.spot(s.half + 4, field.subnasale_y - 8, 6.0, 10.0)
    lower, upper = s.lower * left, s.upper * left
    lips = (s.upper + s.lower) * left
    return {
        "mouthSmile": _vector(corner, 8.5, 8.5, -3.5)
        + _vector(s.upper * left, 1.5, 2.6, -1.2)
        + _vector(s.lower * left, 1.5, 0.2, -1.4)
        + _vector(cheek, 1.0, 4.5, 3.0)
        + _vector(below_eye, 0.0, 1.2, 0.6)
        + _vector(fold, 1.5, 1.5, -0.8),
        "mouthFrown": _vector(corner, 1.5, -7.5, -1.0) + _vector(lower, 0.0, -1.0, 0.0),
        "mouthDimple": _vector(corner, 5.0, 0.5, -4.0) + _vector(cheek, 0.5, 0.6, 0.5),
        "mouthStretch": _vector(corner, 8.0, -3.5, -4.0)
        + _vector(lower, 1.5, -1.5, -0.8)
        + _vector(s.spot(34, -78, 14, 12), 1.5, -1.5, 0.0),
        "mouthPress": _vector(lips * s.off_contact, 0.0, -2.0, 0.0)
        + _vector(lips, 0.0, 0.0, -1.8)
        + _vector(corner, 1.0, 0.3, -1.2),
        "mouthLowerDown": _vector(lower, 0.6, -7.0, 0.3)
        + _vector(s.spot(14, field.mouth_y - 16, 10, 8), 0, -2.0, 0.5),
        "mouthUpperUp": _vector(upper, 0.4, 6.0, 0.6)
        + _vector(wing, 0.4, 1.6, 0.3)
        + _vector(fold, 0.2, 2.0, 0.6),
        "browDown": _vector(brow, -1.2, -5.0, 0.8) + _vector(inner_brow, -2.0, -2.5, 1.0),
        "browOuterUp": _vector(outer_brow, 0.3, 7.0, -0.6)
        + _vector(s.spot(eye_x + 8, brow_y + 18, 17, 8), 0, 2.5, 0),
        "cheekSquint": _vector(cheek, 0.3, 3.8, 2.4) + _vector(below_eye, 0.0, 2.2, 0.9),
        "noseSneer": _vector(wing, 0.8, 4.2, -0.3)
        + _vector(s.spot(9, 8, 6, 9), -0.6, 1.5, 1.2)
        + _vector(upper * bump(s.x, 13, 10), 0.3, 2.8, 0.5)
        + _vector(inner_brow, -0.5, -1.5, 0.4),
        "eyeSquint": _vector(s.spot(eye_x + 4, 8.0, 12.0, 6.0), 0.0, 2.0, 0.9)
        + _vector(brow, 0.0, -0.5, 0.1),
        "eyeWide": _vector(brow, 0.0, 1.6, 0.0),
        "eyeBlink": _vector(brow, 0.0, -0.5, 0.0) + _vector(below_eye, 0.0, 0.4, 0.0),
    }


def _central(s: _Strokes, field: HeadField) -> dict[str, Float64Array]:
    """Shapes of the whole mouth, both brows and both cheeks."""
    side = np.sign(s.x) * smoothstep(0.0, 6.0, np.abs(s.x))
    inward = _vector(-side * s.mouth * np.clip(s.t, 0, 1.2), 1.0)
    inner = np.clip(1 - s.t, 0, 1) ** 0.5
    face, left = field.face, s.left()
    brow_y = 22.0 + face.brow_height
    inner_brows = (
        bump(np.abs(s.x), 0.5 * face.eye_distance - 18, 11.0) * bump(s.y, brow_y + 1, 9.0) * s.front
    )
    mid_forehead = bump(s.x, 0.0, 26.0) * bump(s.y, brow_y + 19, 9.5) * s.front
    puff = bump(np.abs(s.x), s.half + 20, 15.0) * bump(s.y, field.mouth_y + 4, 17.0) * s.front
    lips = s.upper + s.lower
    chin = s.spot(0, field.mouth_y - 25, 17.0, 11.0)
    outwards = np.stack([side, 0 * side, 0.75 + 0 * side], -1)
    return {
        "mouthFunnel": 8.5 * inward
        + _vector(s.mouth, 0, 0, 5.5)
        + _vector(s.upper, 0, 4.2, 2.8)
        + _vector(s.lower, 0, -4.8, 2.8),
        "mouthPucker": 13.0 * inward
        + _vector(s.mouth, 0, 0, 5.0)
        + _vector(lips * inner, 0, 0, 3.5)
        + _vector(lips * s.off_contact, 0, 1.6, 0.0),
        "mouthLeft": _vector(s.mouth, 8.5, 0, 0)
        + _vector(s.mouth * left, 0, 1.5, -2.5)
        + _vector(chin, 2.0, 0, 0),
        "mouthRight": _vector(s.mouth, -8.5, 0, 0)
        + _vector(s.mouth * (1 - left), 0, 1.5, -2.5)
        + _vector(chin, -2.0, 0, 0),
        "mouthRollLower": _vector(s.lower, 0, 1.2, -5.5)
        + _vector(s.lower * s.off_contact, 0, -3.6, 1.2),
        "mouthRollUpper": _vector(s.upper, 0, -0.8, -5.0)
        + _vector(s.upper * s.off_contact, 0, -3.2, 1.5),
        "mouthShrugLower": _vector(s.lower, 0, 3.6, 2.2)
        + _vector(s.upper, 0, 2.6, 1.2)
        + _vector(chin, 0, 4.5, 1.2),
        "mouthShrugUpper": _vector(s.upper, 0, 3.4, 2.4) + _vector(s.lower, 0, 1.0, 0.3),
        "browInnerUp": _vector(inner_brows, 0, 7.5, -0.3) + _vector(mid_forehead, 0, 2.5, 0),
        "cheekPuff": puff[..., None] * outwards * 7.5 + _vector(lips, 0, 0, 1.5),
        # The jaw's own motions are rotations; these are what the skin adds to them.
        "jawOpen": 3.5 * inward
        + _vector(puff * side, -1.6)
        + _vector(s.upper, 0, 2.4, -0.2)
        + _vector(s.corner, 0, 1.0, -1.5),
        "tongueOut": _vector(s.upper, 0, 1.2, 0.8) + _vector(s.lower, 0, -3.5, 1.8),
    }


def _jaw_weights(s: _Strokes) -> tuple[Float64Array, Float64Array]:
    """How much of the jaw's motion the skin takes, with lips free and with lips held together."""
    t = np.clip(s.t, 0.0, 1.0)
    beyond = np.maximum(np.abs(s.x) - s.half, 0.0)
    above = s.y - s.contact
    down = 13.0 + 0.7 * beyond
    up = 9.0 + 1.1 * beyond
    follow = smoothstep(0.0, 45.0, s.z) * smoothstep(162.5, 152.0, s.rows)
    rest = 0.5 - 0.12 * smoothstep(0, 30, beyond)

    def weight(at_lower: Float64Array, at_upper: Float64Array) -> Float64Array:
        low = at_lower + (1 - at_lower) * smoothstep(0.0, 1.0, -above / down)
        high = at_upper * (1 - smoothstep(0.0, 1.0, above / up))
        return np.where(s.is_upper, high, low) * follow

    lower = np.where(s.t < 1, 1.0 - 0.5 * t**2.6, rest)
    upper = np.where(s.t < 1, 0.5 * t**3.2, rest)
    together = np.where(s.t < 1, 0.42 + 0.08 * t**2, rest)
    return weight(lower, upper), weight(together, together)


def build_motion(field: HeadField, skin: Skin, chart: Chart) -> SkinMotion:
    """Displacement fields and jaw weights of one identity's skin."""
    s = _Strokes(field, skin, chart)
    fields = np.zeros((NUM_ARKIT, *s.x.shape, 3))
    for name, value in _sided(s, field).items():
        fields[ARKIT_INDEX[f"{name}Left"]] = value
        # Columns are symmetric about the midline.
        fields[ARKIT_INDEX[f"{name}Right"]] = value[:, ::-1] * [-1.0, 1.0, 1.0]
    for name, value in _central(s, field).items():
        fields[ARKIT_INDEX[name]] = value
    jaw, jaw_closed = _jaw_weights(s)
    return SkinMotion(
        fields=fields.reshape(NUM_ARKIT, -1, 3), jaw=jaw.ravel(), jaw_closed=jaw_closed.ravel()
    )
