"""The drawing half of a receiver: faces in, decoded and drawn frames out. The loop that owns the GL
thread.

    with Viewer(source, ViewerOptions(headless=True, record=Path("call.mp4"))) as viewer:
        viewer.run(seconds=20.0)
        print(viewer.report())

Each frame: ask the source for the faces, hand changed latents to the decode pool, upload what has
been decoded meanwhile, draw, show or record. Decoding runs beside drawing, so a frame shows the
latents of the frame before it. A peer whose avatar is missing or broken sits there as a placeholder
with the reason under the name; the others do not notice.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from pica_client.decode_pool import DecodePool, DecodePoolOptions, DecodeRequest, DecodeResult
from pica_client.decoder import OnnxDecoder, OnnxOptions
from pica_client.errors import OptionError, ShaderError
from pica_client.faces import FaceSource, FaceState
from pica_client.hud import help_item, name_items, statistics_item
from pica_client.recorder import Recorder, save_png
from pica_client.renderer import DrawStats, Renderer, RenderOptions
from pica_client.scene import (
    Placement,
    arrange_seats,
    head_matrix,
    view_camera,
    view_direction,
)
from pica_client.stats import Samples, Summary
from pica_client.typesetting import OverlayItem
from pica_client.window import Window, WindowState
from pica_core.avatar_file import Avatar
from pica_core.camera import Camera
from pica_core.errors import AvatarFileError
from pica_core.gl import create_context

FloatArray = npt.NDArray[np.float32]
StatisticsLines = Callable[[], list[tuple[str, str]]]

VIEW_CHANGE = 0.01
"""Radians by which a head's view must turn before an unchanged latent is decoded again (chosen: the
view-dependent part of a colour changes by less than one step of 255 over it)."""
FADE_OF_STATUS = {"waiting": 0.6, "stale": 0.8, "away": 0.4}
PANEL_PERIOD_S = 0.5
"""How often the statistics panel changes: readable, and a text costs 2 ms to set."""
RECENT_SAMPLES = 60
"""What the panel's figures are made of."""
PREPARE_TIMEOUT_S = 5.0
"""How long the first picture waits for five avatars to be loaded; here they take half a second."""
PREPARE_POLL_S = 0.01
MEASURED = ("decode", "decode_wait", "upload", "draw", "latency")


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewerOptions:
    """How a call is shown."""

    size: tuple[int, int] = (960, 540)
    """Columns and rows of the image or window, pixels."""
    headless: bool = False
    """Draw without a window."""
    record: Path | None = None
    """MP4 file to record into."""
    max_fps: float = 30.0
    """Frames are drawn no more often than this; in a window the display limits too."""
    show_statistics: bool = False
    """Show the statistics panel from the start."""
    title: str = "PiCA Telepresence"
    render: RenderOptions = field(default_factory=RenderOptions)
    decode: DecodePoolOptions = field(default_factory=DecodePoolOptions)
    onnx: OnnxOptions = field(default_factory=OnnxOptions)

    def __post_init__(self) -> None:
        if not 1 <= self.max_fps <= 1000:
            raise OptionError(f"max_fps is {self.max_fps:g}; allowed are 1 to 1000")


@dataclass(slots=True, eq=False)
class _Seat:
    """What the viewer keeps of one peer."""

    avatar_id: str
    avatar: Avatar | None = None
    problem: str = ""
    """Why there is a placeholder instead of the avatar."""
    latent: FloatArray | None = None
    """Submitted last."""
    view: FloatArray | None = None
    captured_us: int = 0
    """Of the newest sample that was decoded."""
    num_decoded: int = 0


class Viewer:
    """Shows the faces of a source in a window or off the screen.

    Args:
        source: Who is there.
        options: See `ViewerOptions`.
        statistics: Further lines for the statistics panel, as (name, value); asked twice a second.
        on_decoded: Told of every decode that reached the GPU, on the drawing thread; its slot is
            the peer id.
        clock: Seconds, monotonic; the same clock that stamps `FaceState.captured_us` when sender
            and receiver share a machine (then `report` holds the latency from sample to decoded
            maps; otherwise it means nothing).

    Raises:
        GraphicsError: No window or no GL context; names the fix.
        OptionError: The recording cannot be written.
        ModuleNotFoundError: Recording without PyAV.
    """

    def __init__(
        self,
        source: FaceSource,
        options: ViewerOptions | None = None,
        *,
        statistics: StatisticsLines | None = None,
        on_decoded: Callable[[DecodeResult], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.options = options or ViewerOptions()
        self._source = source
        self._statistics = statistics
        self._on_decoded = on_decoded
        self._clock = clock
        self._seats: dict[str, _Seat] = {}
        self._state = WindowState(show_statistics=self.options.show_statistics)
        self._samples = {name: Samples() for name in MEASURED}
        self._recent = {name: Samples(RECENT_SAMPLES) for name in MEASURED}
        self._frame_times: deque[float] = deque(maxlen=RECENT_SAMPLES)
        self._num_frames = 0
        self._num_errors = 0
        self._peers_seen: set[str] = set()
        self._panel: tuple[float, tuple[tuple[str, str], ...]] = (-1.0, ())
        self.last_draw: DrawStats | None = None
        with ExitStack() as stack:
            self._window: Window | None = None
            if self.options.headless:
                context = create_context()
                stack.callback(context.release)
            else:
                self._window = stack.enter_context(
                    Window(self.options.title, self.options.size, self._state)
                )
                context = self._window.context
            size = self._window.size_px if self._window else self.options.size
            self._renderer = Renderer(context, size, self.options.render)
            self._recorder = None
            if self.options.record is not None:
                self._recorder = stack.enter_context(Recorder(self.options.record, size))
            self._pool = stack.enter_context(
                DecodePool(self.options.decode, self._make_decoder, self._clock)
            )
            self._resources = stack.pop_all()
        self._started_s = self._clock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop decoding, finish the recording, close the window."""
        self._resources.close()

    def run(
        self, seconds: float | None = None, should_stop: Callable[[], bool] = lambda: False
    ) -> None:
        """Draw until the time is over, `should_stop` says so, or the user closes the window."""
        period_s = 1 / self.options.max_fps
        begin_s = next_s = self._clock()
        while not should_stop():
            now = self._clock()
            if seconds is not None and now - begin_s >= seconds:
                return
            if now < next_s:
                time.sleep(min(next_s - now, 0.05))
                continue
            # A frame that came late does not make the following ones hurry.
            next_s = max(next_s + period_s, now)
            if not self.step(now):
                return

    def prepare(self, timeout_s: float = PREPARE_TIMEOUT_S) -> None:
        """Get everybody ready who has a face by now: decoders, shaders, first maps.

        What this costs belongs to no frame: nothing of it is shown, recorded or measured. Whoever
        is not ready in time sits there as a placeholder until then.
        """
        deadline_s = self._clock() + timeout_s
        while (now := self._clock()) < deadline_s:
            faces, placements, camera = self._arrange(now)
            self._collect_decoded()
            waiting = [self._seats[face.peer_id] for face in faces if face.latent is not None]
            if all(seat.num_decoded or seat.problem for seat in waiting):
                self._renderer.draw(placements, camera, [])
                break
            time.sleep(PREPARE_POLL_S)
        for samples in (*self._samples.values(), *self._recent.values()):
            samples.clear()
        self._started_s = self._clock()

    def step(self, now: float) -> bool:
        """Draw one frame; False once the user wants to leave."""
        if self._window is not None:
            self._state = self._window.poll()
            if self._state.wants_close:
                return False
            self._renderer.resize(self._window.size_px)
        faces, placements, camera = self._arrange(now)
        self._collect_decoded()
        begin_s = self._clock()
        self.last_draw = self._renderer.draw(
            placements, camera, self._overlays(faces, placements, camera, now)
        )
        image = None
        if self._window is None:
            image = self._renderer.read_image()  # waits for the GPU: the draw time is a true one
        self._measure("draw", self._clock() - begin_s)
        if self._recorder is not None:
            if image is None:
                image = self._renderer.read_image()
            self._recorder.write(image, now - self._started_s)
        if self._window is not None:
            self._window.show(self._renderer)
        self._num_frames += 1
        self._frame_times.append(now)
        return True

    def wait_decoded(self, timeout_s: float) -> bool:
        """Wait until nothing is being decoded; False when the time runs out first."""
        return self._pool.wait_idle(timeout_s)

    def save_image(self, path: Path) -> None:
        """Write the last frame as PNG."""
        save_png(path, self._renderer.read_image())

    @property
    def gl_renderer(self) -> str:
        """What draws, by the driver's own name."""
        return self._renderer.gl_renderer

    @property
    def problems(self) -> dict[str, str]:
        """Why peers are drawn as placeholders, by peer id."""
        return {peer_id: seat.problem for peer_id, seat in self._seats.items() if seat.problem}

    def report(self) -> dict[str, Any]:
        """What was drawn so far; durations in milliseconds."""
        elapsed_s = self._clock() - self._started_s
        summaries: dict[str, Summary] = {
            f"{name}_ms": samples.summary_ms() for name, samples in self._samples.items()
        }
        return {
            "frames_rendered": self._num_frames,
            "render_fps": round(self._num_frames / elapsed_s, 2) if elapsed_s > 0 else 0.0,
            "rendered_peers": len(self._peers_seen),
            "decodes": {peer_id: seat.num_decoded for peer_id, seat in self._seats.items()},
            "decodes_replaced": self._pool.num_replaced,
            "errors": self._num_errors,
            "gl_renderer": self.gl_renderer,
            "triangles": self.last_draw.num_triangles if self.last_draw else 0,
            "draw_calls": self.last_draw.num_draw_calls if self.last_draw else 0,
            **summaries,
        }

    def _make_decoder(self, avatar: Avatar) -> OnnxDecoder:
        return OnnxDecoder(avatar, self.options.onnx)

    def _arrange(self, now: float) -> tuple[list[FaceState], list[Placement], Camera]:
        """Who is here, where each sits, and from where they are seen; their latents go off."""
        faces = self._source.faces(now)
        camera = view_camera(self._state.view, len(faces), *self._renderer.size)
        self._forget_absent(faces)
        seats = arrange_seats(len(faces))
        placements = [
            self._place(face, seat, camera) for face, seat in zip(faces, seats, strict=True)
        ]
        return faces, placements, camera

    def _forget_absent(self, faces: list[FaceState]) -> None:
        present = {face.peer_id for face in faces}
        for peer_id in [peer_id for peer_id in self._seats if peer_id not in present]:
            del self._seats[peer_id]
            self._pool.remove(peer_id)
            self._renderer.remove(peer_id)

    def _place(self, face: FaceState, seat: npt.NDArray[np.float64], camera: Camera) -> Placement:
        """Where a face is; on the way, its avatar is prepared and its latent submitted."""
        entry = self._seats.get(face.peer_id)
        if entry is None or entry.avatar_id != face.avatar_id:
            entry = self._seats[face.peer_id] = _Seat(face.avatar_id)
            self._pool.remove(face.peer_id)
            self._renderer.add_placeholder(face.peer_id)
        if entry.avatar is None and not entry.problem:
            self._prepare(face.peer_id, entry)
        matrix = head_matrix(seat, face.rotation, face.translation_m)
        if face.latent is not None and entry.avatar is not None:
            self._submit(face, entry, face.latent, view_direction(matrix, camera.centre_m))
        return Placement(
            slot=face.peer_id, world_from_head=matrix, fade=FADE_OF_STATUS.get(face.status, 0.0)
        )

    def _prepare(self, peer_id: str, entry: _Seat) -> None:
        try:
            avatar = self._source.avatar(entry.avatar_id)
            if avatar is None:
                return
            self._renderer.add_avatar(peer_id, avatar)
        except (AvatarFileError, ShaderError) as error:
            self._give_up(entry, str(error))
            return
        entry.avatar = avatar
        self._pool.add(peer_id, avatar)

    def _submit(
        self, face: FaceState, entry: _Seat, latent: FloatArray, direction: FloatArray
    ) -> None:
        is_turned = entry.view is None or float(np.dot(entry.view, direction)) < np.cos(VIEW_CHANGE)
        is_same = entry.latent is not None and np.array_equal(entry.latent, latent)
        if is_same and not is_turned:
            return
        entry.latent, entry.view = latent, direction
        self._pool.submit(face.peer_id, DecodeRequest(latent, direction, face.captured_us))

    def _collect_decoded(self) -> None:
        for result in self._pool.take_results():
            entry = self._seats.get(result.slot)
            if entry is None:
                continue
            if result.maps is None:
                self._renderer.add_placeholder(result.slot)
                self._give_up(entry, result.error or "cannot be decoded")
                continue
            begin_s = self._clock()
            self._renderer.update_maps(
                result.slot, result.maps.position_map, result.maps.expression_map
            )
            self._measure("upload", self._clock() - begin_s)
            self._measure("decode", result.decode_s)
            self._measure("decode_wait", result.waited_s)
            if result.captured_us > entry.captured_us:  # a newly shown sample, not a turned view
                entry.captured_us = result.captured_us
                self._measure("latency", result.finished_s - result.captured_us * 1e-6)
            entry.num_decoded += 1
            self._peers_seen.add(result.slot)
            if self._on_decoded is not None:
                self._on_decoded(result)

    def _give_up(self, entry: _Seat, problem: str) -> None:
        entry.problem = problem
        self._num_errors += 1

    def _overlays(
        self, faces: list[FaceState], placements: list[Placement], camera: Camera, now: float
    ) -> list[OverlayItem]:
        size = self._renderer.size
        items = name_items(faces, placements, camera, self.problems)
        if self._state.show_statistics:
            items.append(statistics_item(self._panel_lines(len(faces), now), size))
        if self._state.show_help:
            items.append(help_item(size))
        return items

    def _panel_lines(self, num_faces: int, now: float) -> tuple[tuple[str, str], ...]:
        shown_s, lines = self._panel
        if lines and now - shown_s < PANEL_PERIOD_S:
            return lines
        times = self._frame_times
        span_s = times[-1] - times[0] if len(times) > 1 else 0.0
        fps = (len(times) - 1) / span_s if span_s > 0 else 0.0
        found = [("Statistics", ""), ("peers", str(num_faces)), ("drawing", f"{fps:.1f} fps")]
        for name, title, rank in (
            ("draw", "draw", "p50"),
            ("decode", "decode", "p50"),
            ("latency", "latency p95", "p95"),
        ):
            percentile = self._recent[name].summary_ms()[rank]
            if percentile is not None:
                found.append((title, f"{percentile:.1f} ms"))
        if self._statistics is not None:
            found += self._statistics()
        self._panel = (now, tuple(found))
        return self._panel[1]

    def _measure(self, name: str, duration_s: float) -> None:
        self._samples[name].add(duration_s)
        self._recent[name].add(duration_s)
