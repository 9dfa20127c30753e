"""The 52 values of a published capture's frames: the face model's shapes fitted to its meshes.

    register    the face model laid over the neutral mesh, which with its texture is a scan
    match       each tracked vertex to the nearest place on the model that looks the same way
    fit         mesh - neutral mesh = shapes e + a little turn and shift, e within [0, 1]

Vertices count by their area, less where the match is far, and where meshes move as no shape does.
What meshes do not show is 0: the tongue, and the gaze but for what it does to lids.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import lsq_linear
from scipy.spatial import KDTree

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.capture.dataset.dataset import FITTED, Capture
from pica_core.capture.dataset.files import write_archive, write_expressions
from pica_core.capture.dataset.multiface import EXPRESSIONS
from pica_core.capture.me.face import head_faces, small_moves
from pica_core.capture.me.register import register
from pica_core.capture.me.scan import Scan
from pica_core.capture.person.choices import read_model
from pica_core.capture.rig.features import find_features
from pica_core.capture.triangles import areas, samples, vertex_normals
from pica_core.errors import CaptureError
from pica_core.face_networks import FaceNetworks
from pica_core.types import Float64Array, IntArray

NEUTRAL_FRAMES, LOOKED_AT = 8, 200
"""Frames whose median mesh is the neutral one, and those that weights are found with."""
SPACING_M, NEAREST, ALIKE = 0.001, 16, 0.3
"""Samples of the model, how many of them are tried, and the cosine between slopes at least."""
OFF_M = 0.002
"""A match so far away, or what is left so large, counts a quarter."""
CALM_M2, SMALL_M2 = 1e-9, 1e-9
"""What a value and its square cost (measured on a drawn person: 0.03 off in the mean)."""
SHOWN_M = 0.0003
"""Shapes that move no vertex farther stay 0."""


def fit_capture(
    capture: Capture, networks: FaceNetworks, progress: Callable[[int, int], None]
) -> float:
    """Fit the face model to a published capture that was opened without a fit; write what was found
    into its directory, where `Capture.open` reads it.

    Returns:
        How far vertices move as no shape does, metres, in the mean.

    Raises:
        CaptureError: The neutral mesh shows no head in millimetres.
    """
    frames = [f for f in capture.frames if "neutral" in f.segment.lower()] or list(capture.frames)
    frames = frames[:: -(-len(frames) // NEUTRAL_FRAMES)]
    raw = np.median([capture.vertices_m(frame) for frame in frames], axis=0).astype(np.float64)
    faces, count = capture.topology.faces, len(capture.frames)
    scan = Scan(
        path=capture.path,
        points=raw,
        faces=faces,
        uv=capture.topology.vertex_uv.astype(np.float64),
        image=capture.average_texture(frames[0]),
        colours=np.ones((len(raw), 3)),
        has_colour=True,
        has_loose_image=True,  # its rows may count from below
    )
    found = register(scan, networks)
    if found.unit != "m":
        raise CaptureError(f"{capture.path}: the neutral mesh is no head in millimetres")
    model = read_model()
    head, turn = model.shaped(found.rest_m), found.face.pose.rotation.T
    shift = (head.rest_m - found.rest_m)[0] - turn @ found.face.pose.translation
    neutral = raw @ turn.T + shift
    near, between, trust = _match(head.rest_m, head_faces(model, "skin"), neutral, faces)
    motion = np.einsum("nk,snkc->snc", between, head.motion_m[:, near])
    columns = np.concatenate([motion.reshape(NUM_ARKIT, -1).T, small_moves(neutral)[:, :6]], 1)
    shown = np.linalg.norm(motion, axis=2).max(1) > SHOWN_M
    bounds = np.r_[np.zeros(NUM_ARKIT), [-1.0] * 6], np.r_[np.where(shown, 1, 1e-9), [1.0] * 6]
    cost = np.r_[np.full(NUM_ARKIT, SMALL_M2), [1e-12] * 6]

    def offsets(number: int) -> Float64Array:
        moved = capture.vertices_m(capture.frames[number]) @ turn.T + shift
        return np.asarray(moved - neutral).ravel()

    def solver(weights: Float64Array) -> Callable[[Float64Array], Float64Array]:
        weighted = columns * np.repeat(weights / weights.sum(), 3)[:, None]
        root = np.linalg.cholesky(weighted.T @ columns + np.diag(cost))

        def solve(offset: Float64Array) -> Float64Array:
            right = weighted.T @ offset
            right[:NUM_ARKIT] -= CALM_M2 / 2
            target = np.linalg.solve(root, right)
            return np.asarray(lsq_linear(root.T, target, bounds, method="bvls").x)

        return solve

    first = trust * np.bincount(faces.ravel(), np.repeat(areas(neutral, faces), 3), len(neutral))
    weights, left_m = first, np.zeros(1)
    for _ in range(2):
        solve, squares = solver(weights), np.zeros(len(neutral))
        some = range(0, count, -(-count // LOOKED_AT))
        for number in some:
            rest = offsets(number) - columns @ solve(offsets(number))
            squares += (rest.reshape(-1, 3) ** 2).sum(1) / len(some)
        left_m = np.sqrt(squares)
        weights = first / (1 + (left_m / OFF_M) ** 2) ** 2
    solve, values = solver(weights), np.zeros((count, NUM_ARKIT), np.float32)
    for number in range(count):
        values[number] = solve(offsets(number))[:NUM_ARKIT]
        progress(number + 1, count)
    corner, sure = near[np.arange(len(near)), between.argmax(1)], trust > 0.1
    regions = {name: mask[corner] & sure for name, mask in find_features(head).regions.items()}
    write_archive(capture.path / FITTED, to_ours=np.column_stack([turn, shift]), **regions)
    write_expressions(capture.path / EXPRESSIONS, capture.frames, values)
    return float(np.average(left_m, weights=weights))


def _match(
    points: Float64Array, faces: IntArray, vertices: Float64Array, own_faces: IntArray
) -> tuple[IntArray, Float64Array, Float64Array]:
    """Where on a surface each vertex lies: corners ``[V, 3]``, weights of these ``[V, 3]``, and
    how sure that is ``[V]``."""
    which, weights = samples(points, faces, SPACING_M)
    corners = faces[which]
    normals = vertex_normals(points.astype(np.float32), faces)
    slopes = np.einsum("nk,nkc->nc", weights, normals[corners])
    apart, near = KDTree(np.einsum("nk,nkc->nc", weights, points[corners])).query(vertices, NEAREST)
    own = vertex_normals(vertices.astype(np.float32), own_faces)
    alike = (slopes[near] * own[:, None]).sum(2) >= ALIKE
    best = np.where(alike, apart, np.inf).argmin(1)
    row = np.arange(len(vertices))
    trust = alike[row, best] / (1 + (apart[row, best] / OFF_M) ** 2) ** 2
    return corners[near[row, best]], weights[near[row, best]], trust
