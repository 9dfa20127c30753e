"""How far a real recording lies outside of what is trained on: docs/results/expressions.md.

python scripts/expressions_cover.py RECORDING.csv [--frames 256 --seed 0]
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.capture.stage.expressions import sample_takes
from pica_core.capture.stage.own_take import read_own_take

MARGIN = 0.03
"""Nearer than this to a pair's hull counts as inside."""

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("recording", type=Path)
parser.add_argument("--frames", type=int, default=256)
parser.add_argument("--seed", type=int, default=0)
options = parser.parse_args()
real = read_own_take(options.recording).astype(np.float64)
takes = sample_takes(options.frames, options.seed)
trained = np.concatenate([t.arkit for t in takes if t.split == "train"]).astype(np.float64)

outside = np.zeros(len(real), int)
pairs = 0
for one in range(NUM_ARKIT):
    for other in range(one):
        points = np.unique(np.concatenate([trained[:, [one, other]], [[0.0, 0.0]]]), axis=0)
        try:
            planes = ConvexHull(points).equations
        except QhullError:  # a shape that never moves
            continue
        beyond = (real[:, [one, other]] @ planes[:, :2].T + planes[:, 2]).max(1) > MARGIN
        outside += beyond
        pairs += 1
inverse = np.linalg.inv(np.cov(trained.T) + 1e-3 * np.eye(NUM_ARKIT))
away = real - trained.mean(0)
distance = np.sqrt(np.einsum("ij,jk,ik->i", away, inverse, away))
nearest = np.concatenate(
    [
        np.linalg.norm(part[:, None] - trained[None], axis=2).min(1)
        for part in np.array_split(real, 40)
    ]
)
print(f"{len(trained)} training moments, {len(real)} real ones, {pairs} pairs of shapes")
print(f"a shape beyond its range: {(real > trained.max(0) + 0.02).any(1).mean():.1%} of moments")
print(f"outside of a pair's hull: {outside.sum() / pairs / len(real):.2%} of moments and pairs")
print(f"outside of more than ten hulls: {(outside > 10).mean():.1%} of moments")
print("Mahalanobis distance, median, 95 %, most:", np.quantile(distance, [0.5, 0.95, 1]).round(1))
print("nearest training moment, median, 95 %:", np.quantile(nearest, [0.5, 0.95]).round(2))
