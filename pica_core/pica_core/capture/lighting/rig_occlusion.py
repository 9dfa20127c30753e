"""Self-shadowing of a rig: how much of the dome, and of the key light, reaches each vertex.

As `occlusion` does it for the built-in heads: measured once by depth maps from many directions, at
rest and at a few strong expressions; a pose takes a mix of them. Shadow of combinations that no
single expression has is not known.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.capture.lighting.shadow import POSES, DrawDepth, lit, softbox, sphere
from pica_core.capture.rig.head import RigHead
from pica_core.types import FloatArray

DOME_DIRECTIONS = 28
KEY_DIRECTIONS = 6
SPAN_M, CENTRE_M = 0.42, (0.0, -0.03, 0.0)
"""Of the depth maps."""


class RigOcclusion:
    """Shadow of one rig as a function of its expression.

    Args:
        head: The rig.
        draw_depth: Draws a depth map of vertices along a clip matrix (`rig_gpu.RigRenderer`).
    """

    def __init__(self, head: RigHead, draw_depth: DrawDepth) -> None:
        self._head = head
        self._draw_depth = draw_depth
        zero = np.zeros(NUM_ARKIT, np.float32)
        self._rest = self._measure(zero)
        # Expressions that the rig does not have cost nothing.
        self._poses = [p for p in POSES if set(p) <= set(head.names.drivers)]
        changes = []
        for names in self._poses:
            arkit = zero.copy()
            arkit[[ARKIT_INDEX[name] for name in names]] = 1.0
            changes.append(self._measure(arkit) - self._rest)
        self._changes = np.array(changes, np.float32).reshape(len(self._poses), -1)

    def _measure(self, arkit: FloatArray) -> FloatArray:
        vertices = self._head.vertices(arkit)
        normals = self._head.normals(vertices)
        sky = np.zeros(len(vertices))
        weight = np.full(len(vertices), 1e-6)
        for direction in sphere(DOME_DIRECTIONS):
            # Light from above counts more: a dome, not a fog.
            facing = np.maximum(normals @ direction, 0.0) * (0.65 + 0.35 * direction[1])
            sky += facing * self._lit(vertices, normals, direction)
            weight += facing
        disc = softbox(KEY_DIRECTIONS)
        key = np.mean([self._lit(vertices, normals, direction) for direction in disc], axis=0)
        return np.stack([sky / weight, key], 1).astype(np.float32)

    def _lit(
        self, vertices: FloatArray, normals: FloatArray, direction: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.bool_]:
        return lit(self._draw_depth, vertices, normals, direction, span_m=SPAN_M, centre_m=CENTRE_M)

    def at(self, arkit: FloatArray) -> FloatArray:
        """Share of dome and key light that reaches each vertex. float32 ``[V, 2]``."""
        mixed = self._rest
        if self._poses:
            weights = [np.mean([arkit[ARKIT_INDEX[name]] for name in p]) for p in self._poses]
            share = np.clip(np.array(weights, np.float32), 0, 1)
            mixed = mixed + (share @ self._changes).reshape(mixed.shape)
        result: FloatArray = np.clip(mixed, 0.0, 1.0)
        return result
