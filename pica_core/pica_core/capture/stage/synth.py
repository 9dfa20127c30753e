"""Render a subject on the stage into a capture directory.

Files are written aside and renamed; `capture.json` comes last, so a directory with one is
finished. A render that was interrupted goes on where it stopped: a frame counts as done when its
tracked mesh, the last of its files, is there. The same options give the same bytes on the same GL
driver.
"""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from itertools import chain
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import ZipFile, ZipInfo

import numpy as np

from pica_core.camera import EVALUATION_VIEWS, LENSES, dome_cameras
from pica_core.capture.dataset import multiface
from pica_core.capture.dataset.files import (
    BackgroundWriter,
    Take,
    depth_units,
    load_image,
    read_arrays,
    write_tables,
    write_topology,
)
from pica_core.capture.stage.expressions import RATE_HZ, STRIDE, TAKE_FRAMES, blend, sample_takes
from pica_core.capture.stage.flesh import LIVELY, STILL, sway
from pica_core.capture.stage.subject import Subject
from pica_core.capture.stage.tracker import (
    NUM_VERTICES,
    SEATED,
    SimulatedTracker,
    head_to_world,
    track_topology,
)
from pica_core.errors import CaptureError, check_ranges
from pica_core.files import replacing
from pica_core.types import ByteArray, FloatArray

FILE = "poses.npz"
PICTURES = "poses"
"""Folder of their pictures."""
POSES_PER_FRAME = 2
"""Poses of a capture for each of its frames (measured: `docs/training.md`)."""
SEED_STEP = 101
"""Added to a capture's seed for its poses, so that they are of other takes."""


class Poses(NamedTuple):
    """Expressions and what they look like.

    Attributes:
        arkit: float32 ``[P, 52]``.
        vertices_m: Their meshes, head frame, metres, float32 ``[P, V, 3]``.
        cameras: Name of the camera of each pose's picture; empty where there are no pictures.
    """

    arkit: FloatArray
    vertices_m: FloatArray
    cameras: tuple[str, ...] = ()


def pose_expressions(count: int, seed: int) -> FloatArray:
    """Expressions, at least 4, of takes that a capture of this seed has not. ``[P, 52]``."""
    return np.concatenate([take.arkit for take in sample_takes(count, seed + SEED_STEP)])


def picture_path(folder: Path, number: int) -> Path:
    """Where a capture keeps the picture of a pose."""
    return folder / PICTURES / f"{number:06d}.png"


def read_picture(folder: Path, number: int) -> ByteArray:
    """The picture of a pose, uint8 ``[H, W, 3]``."""
    return load_image(picture_path(folder, number), "RGB", None)


def write_poses(
    folder: Path, arkit: FloatArray, meshes_m: Iterable[FloatArray], cameras: Sequence[str] = ()
) -> None:
    """Write poses into a capture, mesh by mesh: offsets from the first one, which is at rest, in
    fp16 (0.01 mm). Arguments are as `Poses` holds them.

    Raises:
        CaptureError: The file cannot be written.
    """
    path, meshes = folder / FILE, iter(meshes_m)
    first = next(meshes)
    small = {"cameras": np.array(cameras, np.str_), "arkit": arkit, "rest_m": first}
    header = {"descr": "<f2", "fortran_order": False, "shape": (len(arkit), *first.shape)}
    try:
        with replacing(path) as unfinished, ZipFile(unfinished, "w") as archive:
            for name, values in small.items():
                with archive.open(ZipInfo(f"{name}.npy"), "w") as file:
                    np.lib.format.write_array(file, values)
            with archive.open(ZipInfo("offsets_mm.npy"), "w", force_zip64=True) as file:
                np.lib.format.write_array_header_1_0(file, header)
                for mesh_m in chain([first], meshes):
                    file.write((1000 * (mesh_m - first)).astype("<f2").tobytes())
    except OSError as error:
        raise CaptureError(f"{path}: cannot write ({error.strerror or error})") from error


def read_poses(folder: Path, num_vertices: int) -> Poses | None:
    """Poses of a capture; None if it has none.

    Raises:
        CaptureError: The file is damaged, or of another mesh.
    """
    path = folder / FILE
    if not path.is_file():
        return None
    found = read_arrays(path)
    if found.keys() != {"arkit", "rest_m", "offsets_mm", "cameras"}:
        raise CaptureError(f"{path}: holds {', '.join(found)}; render the capture again")
    arkit, cameras = found["arkit"], tuple(found["cameras"].tolist())
    vertices_m = found["rest_m"] + found["offsets_mm"].astype(np.float32) / np.float32(1000)
    if vertices_m.shape != (len(arkit), num_vertices, 3):
        raise CaptureError(f"{path}: meshes are {vertices_m.shape[1:]}; {num_vertices} are needed")
    if cameras and len(cameras) != len(arkit):
        raise CaptureError(
            f"{path}: {len(cameras)} pictures of {len(arkit)} poses; render the capture again"
        )
    return Poses(arkit, vertices_m, cameras)


Progress = Callable[[int, int], None]

OPENING = (
    blend(),
    blend(jawOpen=0.7),
    blend(eyeBlink=1.0),
    blend(mouthSmile=0.9),
    blend(mouthPucker=0.9),
)
"""Expressions that the tracked mesh is chosen by: at rest, lips and lids hide much."""
_USED = "not empty, and no interrupted render of the same options; name another directory"


@dataclass(frozen=True, kw_only=True, slots=True)
class RenderOptions:
    """How to render a subject."""

    frames: int = 64
    """Frames in all."""
    cameras: int = 8
    """Cameras; the first five are the evaluation views front, left, right, up, down."""
    lenses: str = "mixed"
    """mixed: some cameras look at mouth and eyes from near; one: all have one lens and look at the
    head, as in the paper's dome."""
    size: str = "512x384"
    """Image size, columns x rows, pixels."""
    texture_size: int = 256
    """Side of the average textures, texels."""
    seed: int = 0
    """Fixes performance, head motion and the errors of tracking."""
    tracked_vertices: int = NUM_VERTICES
    """Vertices that the tracked mesh aims at."""
    workers: int = 1
    """Processes that render."""
    folds: bool = False
    """Motion that no sum of shapes holds: skin folds and slides, hair swings, the tongue moves, the
    head more."""

    def __post_init__(self) -> None:
        many = 100_000
        check_ranges(self, CaptureError, frames=(4, many), cameras=(1, 100))
        check_ranges(self, CaptureError, texture_size=(16, 4096), seed=(0, 2**31), workers=(1, 64))
        check_ranges(self, CaptureError, tracked_vertices=(100, many))
        if self.lenses not in LENSES:
            raise CaptureError(f"lenses is {self.lenses!r}; there are {', '.join(LENSES)}")
        if not all(16 <= side <= 8192 for side in self.size_px):
            raise CaptureError(f"size is {self.size}; sides of 16 to 8192 pixels are allowed")

    @property
    def size_px(self) -> tuple[int, int]:
        """Image columns and rows."""
        found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", self.size)
        if found is None:
            raise CaptureError(f"size is {self.size!r}; columns x rows such as 512x384 is needed")
        return int(found[1]), int(found[2])


def render_subject(
    make_subject: Callable[[], Subject],
    options: RenderOptions,
    out: Path,
    progress: Progress = lambda done, total: None,
) -> dict[str, Any]:
    """Render a capture; returns counts: frames, cameras, images, train, test, resumed.

    Args:
        make_subject: Makes the subject to be rendered; what that raises is raised before a file is
            written. It is released at the end.
        out: Directory to fill: new, empty, or an interrupted render of the same subject and
            options.
        progress: Called with frames done and frames in all.

    Raises:
        CaptureError: `out` holds something else, or cannot be written.
        GraphicsError: No GL context.
    """
    if out.exists() and not out.is_dir():
        raise CaptureError(f"{out}: is no directory; name one to make")
    marker = out / multiface.MARKER
    used = out.exists() and any(out.iterdir())
    if used and not marker.is_file():
        raise CaptureError(f"{out}: {_USED}")
    takes = sample_takes(options.frames, options.seed)
    subject = make_subject()
    try:
        asked = {name: value for name, value in asdict(options).items() if name != "workers"}
        whole = {"options": asked, "subject": subject.about}
        fingerprint = json.dumps(whole, sort_keys=True, default=str)
        if used and multiface.read_text(marker) != fingerprint:
            raise CaptureError(f"{out}: {_USED}")
        multiface.write_aside(marker, fingerprint.encode())
        if options.folds:
            subject.enliven()
        counts = _render(subject, options, takes, out, progress)
        _pose(subject, options, out)
    finally:
        subject.release()
    marker.unlink(missing_ok=True)
    return counts


class _Rendering:
    """One subject in front of the cameras."""

    def __init__(
        self, subject: Subject, options: RenderOptions, out: Path, writer: BackgroundWriter
    ) -> None:
        self.subject, self.options, self.out, self.writer = subject, options, out, writer
        self.motion = LIVELY if options.folds else SEATED
        self.cameras = dome_cameras(options.cameras, *options.size_px, options.lenses)
        shapes = np.stack([subject.pose(arkit) for arkit in OPENING])
        tracked_topology, self.tracked = track_topology(
            subject.topology, shapes, options.tracked_vertices
        )
        self.tracker = SimulatedTracker(
            tracked_topology, shapes[0, self.tracked], options.seed, self.tracked
        )
        times_s = np.arange(TAKE_FRAMES) * STRIDE / RATE_HZ
        self._sways = lru_cache(1)(lambda number: sway(options.seed, number, times_s))
        multiface.write_aside(out / multiface.KRT, multiface.krt_text(self.cameras).encode())
        write_topology(
            out / multiface.TOPOLOGY, subject.topology, tracked_topology.faces, self.tracked
        )

    def draw_frame(self, take: Take, number: int, index: int) -> None:
        """Draw and write one frame; its tracked mesh comes last."""
        frame, time_s = f"{index:06d}", index * STRIDE / RATE_HZ
        arkit = take.arkit[index]
        swaying = self._sways(number)[index] if self.options.folds else STILL
        exact = self.subject.pose(arkit, swaying)
        pose = head_to_world(self.options.seed, number, time_s, self.motion)
        cameras = [camera.in_head(pose) for camera in self.cameras]
        views, texture = self.subject.photograph(cameras, self.options.texture_size)
        for camera, view in zip(cameras, views, strict=True):
            for kind, make in (
                ("images", partial(np.asarray, view.image)),
                ("depth", partial(depth_units, view.depth_m)),
            ):
                path = multiface.part_path(kind, take.segment, frame, camera.name)
                self.writer.image(self.out / path, make)
        path = multiface.part_path("texture", take.segment, frame, size=self.options.texture_size)
        self.writer.image(self.out / path, lambda: np.ascontiguousarray(texture[::-1]))
        rows = np.concatenate([pose[:, :3], multiface.MILLIMETRES * pose[:, 3:]], axis=1)
        text = "".join(" ".join(repr(float(v)) for v in row) + "\n" for row in rows)
        multiface.write_aside(
            self.out / multiface.part_path("pose", take.segment, frame), text.encode()
        )
        tracked = self.tracker.follow(exact[self.tracked], number, time_s)
        truth = multiface.part_path(multiface.TRUTH_MESH, take.segment, frame)
        multiface.write_aside(self.out / truth, _millimetres(exact).tobytes())
        self.writer.finish()
        mesh = multiface.part_path("tracked_mesh", take.segment, frame)
        multiface.write_aside(self.out / mesh, _millimetres(tracked).tobytes())


def _millimetres(vertices_m: FloatArray) -> FloatArray:
    return (vertices_m * multiface.MILLIMETRES).astype("<f4")


Frame = tuple[int, Take, int]
"""Number of a take, the take, and a frame's place in it."""


def _mesh_of(out: Path, frame: Frame) -> Path:
    """The last file that is written of a frame."""
    _, take, index = frame
    return out / multiface.part_path("tracked_mesh", take.segment, f"{index:06d}")


def _draw(
    subject: Subject,
    options: RenderOptions,
    out: Path,
    frames: list[Frame],
    progress: Callable[[int], None] = lambda done: None,
) -> None:
    """Draw frames, in a process that may have been made for them."""
    if not frames:
        return
    with BackgroundWriter() as writer:
        rendering = _Rendering(subject, options, out, writer)
        for done, (number, take, index) in enumerate(frames, start=1):
            rendering.draw_frame(take, number, index)
            progress(done)


def _render(
    subject: Subject, options: RenderOptions, takes: list[Take], out: Path, progress: Progress
) -> dict[str, Any]:
    frames = [(k, take, index) for k, take in enumerate(takes) for index in range(len(take.arkit))]
    left = [frame for frame in frames if not _mesh_of(out, frame).is_file()]
    resumed = len(frames) - len(left)
    if options.workers == 1:
        _draw(subject, options, out, left, lambda done: progress(resumed + done, len(frames)))
    else:
        shares = [left[worker :: options.workers] for worker in range(options.workers)]
        with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
            waiting = {pool.submit(_draw, subject, options, out, each) for each in shares if each}
            while waiting:
                done, waiting = wait(waiting, 1.0, FIRST_COMPLETED)
                for share in done:
                    share.result()
                progress(sum(_mesh_of(out, each).is_file() for each in frames), len(frames))
    write_tables(out, takes, _describe(subject, options))
    num_test = sum(take.split == "test" for _, take, _ in frames)
    return {
        "frames": len(frames),
        "cameras": options.cameras,
        "images": len(frames) * options.cameras,
        "train": len(frames) - num_test,
        "test": num_test,
        "resumed": resumed,
    }


def _pose(subject: Subject, options: RenderOptions, out: Path) -> None:
    """Write poses beside the frames, with a picture of each from some camera."""
    cameras = dome_cameras(options.cameras, *options.size_px, options.lenses)
    arkit = pose_expressions(POSES_PER_FRAME * options.frames, options.seed)
    random = np.random.default_rng([options.seed, 0x905E])
    views = [cameras[place] for place in random.integers(len(cameras), size=len(arkit))]
    with BackgroundWriter() as writer:

        def meshes() -> Iterator[FloatArray]:
            for number, (values, camera) in enumerate(zip(arkit, views, strict=True)):
                yield subject.pose(values)
                path = picture_path(out, number)
                if not path.is_file():
                    writer.image(path, partial(np.asarray, subject.draw(camera).image))
            writer.finish()

        write_poses(out, arkit, meshes(), [camera.name for camera in views])


def _describe(subject: Subject, options: RenderOptions) -> dict[str, Any]:
    """What `capture.json` says."""
    return {
        **subject.about,
        "seed": options.seed,
        "units": {
            "tracked_mesh": "mm",
            "truth_mesh": "mm",
            "KRT": "mm",
            "depth": f"{multiface.DEPTH_UNIT_M * multiface.MILLIMETRES:g} mm",
            "images": "sRGB 8 bit",
        },
        "tracked_mesh": "a subset of the exact vertices with a simulated tracker's errors",
        "width": options.size_px[0],
        "height": options.size_px[1],
        "texture_size": options.texture_size,
        "evaluation_views": list(EVALUATION_VIEWS),
    }
