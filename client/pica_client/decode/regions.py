"""Vertices by bases, region by region: those that have not moved are neither made nor uploaded.

A region is a row of the sheet (`pica_core.avatar.linear`), a linear function of a few numbers of
its own. It keeps the vertices that it has until those numbers may have moved one of them by more
than `SKIP_M`, counted from the moment at which the row was made: what is skipped adds up to no more
than that, however slowly a face moves. Rows that are made are exact. Not for several threads at
once: a decode continues from the one before.
"""

import itertools

import numpy as np

from pica_core.avatar.file import Avatar
from pica_core.avatar.linear import PREFIX, RANK, REGION
from pica_core.avatar.spec import POSITION_CHANNELS
from pica_core.types import FloatArray, Int64Array

SKIP_M = 4e-5
"""Farthest that a vertex of a skipped region may be off (chosen: an eighth of a pixel where the
head is 1000 pixels high)."""
NOWHERE = 1e30
"""Number of a direction that no face has."""
_COLUMNS = REGION * POSITION_CHANNELS
_VERSIONS = itertools.count(1)
"""One count for all decoders of the process, so that rows of two are never taken for the same."""


class RegionDecoder:
    """The full level's vertices of one avatar whose spec says `bases`.

    Args:
        skip_m: Farthest that a vertex may be off; 0 makes every row that moves at all.

    Attributes:
        num_decoded: Rows made so far.
        num_skipped: Rows kept so far.
    """

    def __init__(self, avatar: Avatar, skip_m: float = SKIP_M) -> None:
        tensors, scale_m = avatar.tensors, avatar.manifest.position_scale_m
        self._weight, self._bias = tensors[f"{PREFIX}weight"], tensors[f"{PREFIX}bias"]
        self._skip_m = skip_m
        rank, basis = tensors[RANK], tensors[f"{PREFIX}basis"].reshape(-1, _COLUMNS)
        # The mean is one more direction of each region, whose number is always 1.
        after = np.cumsum(rank)
        self._mix_m = np.insert(scale_m * tensors[f"{PREFIX}mix"], after, 0, 0).astype(np.float32)
        self._offset = np.insert(np.zeros(len(basis), np.float32), after, 1)
        mean = tensors[f"{PREFIX}mean"].reshape(-1, _COLUMNS)
        self._basis = np.insert(basis, after, mean, 0)
        reach = np.linalg.norm(basis.reshape(len(basis), REGION, -1), axis=2).max(1, initial=0)
        self._reach = np.insert(reach, after, 0)
        ends = np.cumsum(rank + 1)
        self._starts, self._counts = ends - rank - 1, rank + 1
        self._parts = [slice(*part) for part in np.stack([self._starts, ends], 1).tolist()]
        self._made_of = np.full(len(self._basis), NOWHERE, np.float32)
        self._made_of[ends - 1] = 1
        self._sheet = mean.copy()
        self._versions = np.full(len(mean), next(_VERSIONS), np.int64)
        self.num_decoded = self.num_skipped = 0

    def decode(self, latent: FloatArray) -> tuple[FloatArray, Int64Array]:
        """The sheet of a latent ``[8, 8, 4]``, and its rows' versions: see `DecodedMaps`."""
        weights = self._weight @ latent.reshape(-1) + self._bias
        local = self._mix_m @ weights + self._offset
        moved_m = np.add.reduceat(self._reach * np.abs(local - self._made_of), self._starts)
        is_moved = ~(moved_m <= self._skip_m)
        rows = np.flatnonzero(is_moved).tolist()
        for row in rows:
            part = self._parts[row]
            np.dot(local[part], self._basis[part], out=self._sheet[row])
        np.copyto(self._made_of, local, where=np.repeat(is_moved, self._counts))
        self._versions[is_moved] = next(_VERSIONS)
        self.num_decoded += len(rows)
        self.num_skipped += len(self._sheet) - len(rows)
        # Copies: whoever uploads does so while the next face is decoded.
        shape = (-1, REGION, POSITION_CHANNELS)
        return self._sheet.reshape(shape).copy(), self._versions.copy()
